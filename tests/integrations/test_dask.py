"""Queries of Dask arrays: the bytes of a tracer, whatever the chunks and the scheduler, and small graphs."""

import time

import cloudpickle
import dask
import dask.array as da
import numpy as np
import pytest

from clbvh import QueryError, Renderer, Scene, SceneRef, Tracer, View, make_shape
from clbvh.integrations.dask import ambient_occlusion, any_hit, closest_hit, closest_point, count_hits, render_frames
from clbvh.rendering import scene_ref

RNG = np.random.default_rng(60)
ORIGINS = RNG.normal(size=(40, 7, 1, 3))
DIRECTIONS = RNG.normal(size=(7, 5, 3))
T_MAX = RNG.uniform(0, 3, (40, 1, 5))
MASK = RNG.integers(1, 4, 5)
POINTS = RNG.normal(size=(50, 4, 3))
NORMALS = RNG.normal(size=(4, 3))


@pytest.fixture(autouse=True)
def _in_threads():
    with dask.config.set(scheduler="threads"):
        yield


def chunked(array, *chunks):
    return da.from_array(array, chunks=chunks)


def assert_same(answer, expected):
    """Compare dask arrays, or dicts of them, with an answer of a tracer."""
    fields = answer if isinstance(answer, dict) else {"": answer}
    for name, obtained in fields.items():
        wanted = np.asarray(getattr(expected, name) if name else expected)
        assert (obtained.dtype, obtained.shape) == (wanted.dtype, wanted.shape), name
        found = obtained.compute()
        assert (found.dtype, found.tobytes()) == (wanted.dtype, wanted.tobytes()), name


@pytest.mark.parametrize("given", ["tracer", "reference", "embedded", "in memory"])
def test_rays_get_the_bytes_of_a_tracer_in_any_chunks(source, tracer, open_tracer, given, tmp_path):
    tracer = open_tracer(source)
    sources = {"tracer": lambda: tracer, "embedded": lambda: SceneRef.embed(source), "in memory": lambda: source}
    if given == "reference":
        (source if isinstance(source, Scene) else Scene(source)).save(tmp_path / "it.scene")
    scene = sources.get(given, lambda: tmp_path / "it.scene")()
    rays, limits = (ORIGINS, DIRECTIONS), {"t_max": T_MAX, "t_min": 0.01, "mask": MASK}
    lazy = chunked(ORIGINS, 11, 3, 1, 2), chunked(DIRECTIONS, 4, 2, 3)
    lazy_limits = {"t_max": chunked(T_MAX, 20, 1, 5), "t_min": 0.01, "mask": chunked(MASK, 3)}
    for query in (closest_hit, any_hit, count_hits):
        assert_same(query(scene, *lazy, **lazy_limits), getattr(tracer, query.__name__)(*rays, **limits))
    assert_same(any_hit(scene, [0, 0, 5], [0, 0, -1]), tracer.any_hit([0, 0, 5], [0, 0, -1]))
    assert_same(closest_hit(scene, np.zeros((0, 3)), [0, 0, -1]), tracer.closest_hit(np.zeros((0, 3)), [0, 0, -1]))


def test_points_get_the_bytes_of_a_tracer_in_any_chunks(source, open_tracer):
    tracer, points = open_tracer(source), chunked(POINTS, 13, 2, 3)
    assert_same(closest_point(tracer, points, mask=2), tracer.closest_point(POINTS, mask=2))
    near, lengths = RNG.uniform(0.1, 2, (50, 4)), {"rays": 16, "seed": 3, "offset": 0.001}
    for lazy, given in (((points, NORMALS), (POINTS, NORMALS)), ((NORMALS, points), (NORMALS, POINTS))):
        assert_same(
            ambient_occlusion(tracer, *lazy, max_distance=chunked(near, 50, 3), **lengths),
            tracer.ambient_occlusion(*given, max_distance=near, **lengths),
        )
    assert_same(ambient_occlusion(tracer, [0, 0, 2], [0, 0, 1]), tracer.ambient_occlusion([0, 0, 2], [0, 0, 1]))


def test_nothing_is_computed_early_and_graphs_are_small(tmp_path, monkeypatch):
    monkeypatch.setattr(scene_ref, "open_tracer", None)
    monkeypatch.setattr(Tracer, "_open", None)
    large = make_shape("terrain", triangles=200_000)
    Scene(large).save(tmp_path / "it.scene")
    rays = da.zeros((1_000_000, 3), chunks=(1000, 3))
    begin = time.perf_counter()
    graphs = [closest_hit(source, rays, [0, 0, -1])["t"].__dask_graph__() for source in (tmp_path / "it.scene", large)]
    assert time.perf_counter() - begin < 2.0  # 0.03 s
    small, embedded = map(len, map(cloudpickle.dumps, graphs))
    assert small < 20_000
    assert embedded < small + 1.1 * (large.vertices.nbytes + large.faces.nbytes)


def test_processes_get_the_same_bytes(tracer, mesh):
    with dask.config.set(scheduler="processes", num_workers=1):
        assert_same(any_hit(mesh, chunked(POINTS, 25, 4, 3), [0, 0, 1]), tracer.any_hit(POINTS, [0, 0, 1]))


def test_wrong_shapes_are_refused_at_once_and_wrong_rays_where_they_are_cast(tracer):
    with pytest.raises(QueryError, match=r"closest_hit takes arrays of shape \(\.\.\., 3\), not \(4, 2\)"):
        closest_hit(tracer, da.zeros((4, 2)), [0, 0, 1])
    with pytest.raises(QueryError, match="t_max must broadcast to an answer of 1 axes, and has 2"):
        any_hit(tracer, da.zeros((4, 3)), [0, 0, 1], t_max=np.ones((2, 4)))
    with pytest.raises(QueryError, match="length zero"):
        any_hit(tracer, da.zeros((4, 3)), [0, 0, 0]).compute()


def test_frames_are_those_of_a_renderer(session, world):
    views = [View(width=40, height=30, side=side) for side in ("front", "top")]
    views.append(views[0].changed(transparent=True))
    with Renderer(world) as renderer:
        frames = dask.compute(*render_frames(world, views))
        own = dask.compute(*render_frames(renderer, views))
        for view, frame, again in zip(views, frames, own, strict=True):
            picture = renderer.render(view)
            assert (frame == again).all()
            assert (frame[..., :3] == picture.rgb).all()
        assert frames[2].shape == (30, 40, 4)
        assert (frames[2][..., 3] == picture.alpha).all()
