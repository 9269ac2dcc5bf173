"""Rays and points that no array, no memory and no float64 can hold."""

import numpy as np
import pytest

from clbvh import QueryError, Renderer, SceneError, Tracer, make_shape
from clbvh.support import memory

RAY_QUERIES = ["closest_hit", "closest_prim", "any_hit", "count_hits", "all_hits"]
POINT_QUERIES = ["closest_point", "contains", "signed_distance"]
MANY = 2**40


@pytest.fixture(scope="module")
def tracer(_opened_device):
    with Tracer(make_shape("icosphere", triangles=320)) as tracer:
        yield tracer


def ask(tracer, query, start):
    return getattr(tracer, query)(start, [0, 0, -1]) if query in RAY_QUERIES else getattr(tracer, query)(start)


class TestMemory:
    @pytest.mark.parametrize("query", RAY_QUERIES + POINT_QUERIES)
    def test_more_results_than_fit_are_refused_before_the_work(self, tracer, query):
        start = np.broadcast_to(np.array([0.0, 0.0, 5.0]), (MANY, 3))
        with pytest.raises(QueryError, match=r"results of 1,099,511,627,776 \w+ need about .* are free: ask for fewer"):
            ask(tracer, query, start)

    @pytest.mark.parametrize("query", RAY_QUERIES + POINT_QUERIES)
    def test_the_free_memory_decides(self, tracer, query, monkeypatch):
        monkeypatch.setattr(memory, "_LEAST_CHECKED", 0)
        start = np.zeros((1000, 3))
        monkeypatch.setattr(memory, "free_memory_bytes", lambda: 999)
        with pytest.raises(QueryError, match="results of 1,000"):
            ask(tracer, query, start)
        monkeypatch.setattr(memory, "free_memory_bytes", lambda: 40_000)
        ask(tracer, query, start)

    def test_start_points_for_more_directions_than_fit(self, tracer):
        hits = tracer.closest_hit([0, 0, 5], [0, 0, -1])
        with pytest.raises(QueryError, match="results of 1,099,511,627,776 rays"):
            hits.offset_origins(towards=np.broadcast_to(np.array([0.0, 0.0, 1.0]), (MANY, 3)))

    def test_pictures(self, tracer, monkeypatch):
        monkeypatch.setattr(memory, "free_memory_bytes", lambda: 2**30)
        with Renderer(tracer.mesh) as renderer:
            with pytest.raises(SceneError, match="a picture of 65535 x 65535 needs about"):
                renderer.render(width=65535, height=65535)
            with pytest.raises(SceneError, match="the rays of 65,535 rows need about"):
                renderer.camera.rays(65535, 65535)
            assert renderer.render(width=4, height=3).rgb.shape == (3, 4, 3)


class TestShapes:
    @pytest.mark.parametrize("axes", [33, 63])
    def test_more_axes_than_numpy_broadcasts(self, tracer, axes):
        many = np.ones((1,) * axes + (3,))
        assert tracer.closest_hit(many, many).shape == (1,) * axes
        with pytest.raises(QueryError, match="shapes that broadcast against each other"):
            tracer.closest_hit(many, np.ones((5, 3)))
        with pytest.raises(QueryError, match="towards must have a shape that broadcasts"):
            tracer.closest_hit([0, 0, 5], [0, 0, -1]).offset_origins(towards=many)

    def test_shapes_of_no_array(self, tracer):
        one, other = (np.broadcast_to(np.float32(1), shape) for shape in ((0, 2**30, 1, 3), (2**34, 3)))
        with pytest.raises(QueryError, match="shapes that broadcast against each other"):
            tracer.any_hit(one, other)


class TestNumbers:
    def test_integers_that_float64_cannot_hold(self, tracer):
        for arguments, limits in ((([10**400, 0, 0], [0, 0, 1]), {}), (([0, 0, 0], [0, 0, 1]), {"t_max": 10**400})):
            with pytest.raises(QueryError, match="must be numbers: int too large"):
                tracer.any_hit(*arguments, **limits)

    def test_masked_values_are_no_numbers(self, tracer):
        masked = np.ma.masked_array(np.ones((4, 3)), mask=np.eye(4, 3))
        for ask_for in (
            lambda: tracer.any_hit(masked, [0, 0, 1]),
            lambda: tracer.any_hit([0, 0, 1], masked),
            lambda: tracer.any_hit([0, 0, 1], [0, 0, 1], t_min=np.ma.masked),
            lambda: tracer.closest_point(masked),
        ):
            with pytest.raises(QueryError, match="some are masked"):
                ask_for()
        assert tracer.any_hit(np.ma.masked_array(np.ones((4, 3))), [0, 0, 1]).shape == (4,)


class TestTowards:
    @pytest.mark.parametrize("wrong", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [0, -np.inf, 0]])
    def test_directions_that_lead_nowhere(self, tracer, wrong):
        hits = tracer.closest_hit([[9, 9, 5], [0, 0, 5], [0.1, 0, 5]], [0, 0, -1])
        with pytest.raises(QueryError, match=r"towards must be finite directions of length above 0.*of the hit \(1,\)"):
            hits.offset_origins(towards=wrong)
        with pytest.raises(QueryError, match=r"of the hit \(0, 2\)"):
            hits.offset_origins(towards=[[[1, 0, 0], [1, 0, 0], wrong]])
        with pytest.raises(QueryError, match="length above 0"):
            hits[1].offset_origins(towards=wrong)
        # Whatever is computed from the normal of a miss is NaN.
        directions = np.array([wrong, [1, 0, 0], [5e-324, 0, 0]], np.float64)
        assert np.isfinite(hits.offset_origins(towards=directions)).all(axis=1).tolist() == [False, True, True]
