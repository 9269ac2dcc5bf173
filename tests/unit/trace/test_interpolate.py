"""Values of vertices and spheres at hits."""

import numpy as np
import pytest

import clbvh
from clbvh.errors import ConfigError, QueryError
from clbvh.trace.hits import interpolate as module
from clbvh.trace.hits.hits import Hits
from clbvh.trace.hits.surface import Surface

KNOT = clbvh.make_shape("knot", triangles=1000)
BALLS = clbvh.Spheres(np.random.default_rng(0).normal(size=(20, 3)), 0.25)


class Handle:
    def __init__(self, number):
        self.id = number


def knot_hits(count, seed=0, shape=None):
    generator = np.random.default_rng(seed)
    u, v = generator.uniform(0, 0.5, (2, count))
    prim_id = generator.integers(-1, KNOT.face_count, count).astype(np.int32)
    return Hits(*(values.reshape((count,) if shape is None else shape) for values in (u, u, v, prim_id)), KNOT)


def scene_hits(count, seed=0):
    """Hits of a scene of two geometries, on three instances."""
    generator = np.random.default_rng(seed)
    surface = Surface.from_shapes([KNOT, BALLS], ["knot", "balls"], np.array([1, 0, 1]), np.stack([np.eye(4)] * 3))
    u, v = generator.uniform(0, 0.5, (2, count))
    instance_id = generator.integers(-1, 3, count).astype(np.int32)
    prim_id = generator.integers(0, 20, count).astype(np.int32)
    prim_id[instance_id == -1] = -1
    return Hits(u, u, v, prim_id, surface=surface, known_instance_id=instance_id)


def test_vertices_give_the_bytes_of_the_locations():
    hits = knot_hits(40_000)
    assert hits.interpolate(KNOT.vertices).tobytes() == hits.locations.tobytes()


@pytest.mark.parametrize("dtype", ["float64", "float32", "float16", "int8", "uint64", "bool"])
@pytest.mark.parametrize("width", [(), (1,), (2, 3), (0,)])
def test_values_of_any_width_and_type(width, dtype):
    values = np.random.default_rng(1).uniform(0, 100, (len(KNOT.vertices), *width)).astype(dtype)
    hits = knot_hits(50, shape=(5, 10))
    result = hits.interpolate(values)
    assert result.shape == (5, 10, *width)
    assert result.dtype == np.float64
    for index in np.ndindex(5, 10):
        if hits.prim_id[index] == -1:
            assert np.isnan(result[index]).all()
            continue
        a, b, c = values[KNOT.faces[hits.prim_id[index]]].astype(np.float64)
        u, v = hits.u[index], hits.v[index]
        np.testing.assert_allclose(result[index], (1 - u - v) * a + u * b + v * c, rtol=1e-12, atol=1e-12)


def test_lists_are_values_too_and_a_constant_stays_one():
    result = knot_hits(100)[knot_hits(100).is_hit].interpolate([0.1] * len(KNOT.vertices))
    assert (result == 0.1).all()


def test_a_single_hit_and_no_hits():
    assert knot_hits(1, shape=()).interpolate(KNOT.vertices).shape == (3,)
    assert knot_hits(0).interpolate(KNOT.vertices).shape == (0, 3)


def test_a_vertex_without_a_number_makes_its_faces_nan():
    values = np.ones(len(KNOT.vertices))
    values[7] = np.nan
    hits = knot_hits(5000)
    touches = (KNOT.faces[hits.prim_id] == 7).any(axis=1)
    np.testing.assert_array_equal(np.isnan(hits.interpolate(values)), touches | ~hits.is_hit)


@pytest.mark.parametrize("keys", [(0, 1), ("knot", "balls"), (np.int64(0), Handle(1))], ids=["ids", "names", "handles"])
def test_scenes_take_a_mapping_of_geometries(keys):
    hits = scene_hits(3000)
    colours, temperatures = KNOT.vertices, np.random.default_rng(2).normal(size=(20, 3))
    result = hits.interpolate({keys[0]: colours, keys[1]: temperatures})
    on_knot, on_balls = hits.geometry_id == 0, hits.geometry_id == 1
    np.testing.assert_array_equal(result[on_knot], hits.locations[on_knot])
    np.testing.assert_array_equal(result[on_balls], temperatures[hits.prim_id[on_balls]])
    assert np.isnan(result[~hits.is_hit]).all()


def test_geometries_without_values_are_nan():
    hits = scene_hits(200)
    result = hits.interpolate({"balls": np.ones(20)})
    np.testing.assert_array_equal(np.isnan(result), hits.geometry_id != 1)
    assert np.isnan(hits.interpolate({})).all()


def test_a_mesh_is_a_scene_of_one_geometry():
    hits = knot_hits(10)
    expected = hits.interpolate(KNOT.vertices)
    for key in (0, "knot", Handle(0)):
        np.testing.assert_array_equal(hits.interpolate({key: KNOT.vertices}), expected)


def test_a_mesh_in_a_scene_has_the_ids_and_names_of_the_scene():
    surface = Surface.from_shapes([BALLS, KNOT], ["a", "b"], np.array([1]), None)
    plain = knot_hits(100)
    hits = Hits(plain.t, plain.u, plain.v, plain.prim_id, surface=surface)
    assert hits.mesh is KNOT
    assert hits.locations.tobytes() == plain.locations.tobytes()
    np.testing.assert_array_equal(hits.instance_id, np.minimum(plain.prim_id, 0))
    np.testing.assert_array_equal(hits.geometry_id, np.where(plain.is_hit, 1, -1))
    np.testing.assert_array_equal(hits.interpolate({"b": KNOT.vertices}), plain.locations)
    assert np.isnan(hits.interpolate({"a": np.ones(20)})).all()


@pytest.mark.parametrize(
    ("attribute", "message"),
    [
        (np.ones(20), "the scene has 2 geometries: give the values as a mapping"),
        ({"car": np.ones(20)}, "no geometry with the name 'car', but 'knot', 'balls'"),
        ({2: np.ones(20)}, "no geometry with the id 2: there are 2"),
        ({-1: np.ones(20)}, "no geometry with the id -1"),
        ({True: np.ones(20)}, "not for True"),
        ({1.5: np.ones(20)}, r"not for 1\.5"),
        ({"balls": np.ones(20), 1: np.ones(20)}, "values for the geometry 'balls' twice"),
        ({"balls": np.ones(19)}, r"balls: there must be one value or row for each of the 20 spheres, not \(19,\)"),
        ({"knot": np.ones((497, 2)), "balls": np.ones(20)}, r"'knot': \(497, 2\), 'balls': \(20,\)"),
        ({"knot": 1.0}, r"each of the 497 vertices, not \(\)"),
        ({"balls": ["x"] * 20}, "real numbers, not <U1"),
        ({"balls": np.ones(20, complex)}, "real numbers, not complex128"),
        ({"balls": [[1], [1, 2]]}, "rows differ in length"),
        ({"balls": np.ma.masked_equal(np.arange(20), 3)}, "some are masked"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_wrong_values_are_refused(attribute, message):
    with pytest.raises(QueryError, match=message):
        scene_hits(10).interpolate(attribute)


def test_hits_without_a_mesh_are_refused():
    with pytest.raises(ConfigError, match="do not know their mesh"):
        Hits(*np.zeros((3, 1)), np.zeros(1, np.int32)).interpolate([1.0])


def test_results_that_do_not_fit_the_memory_are_refused(monkeypatch):
    monkeypatch.setattr("clbvh.support.memory.free_memory_bytes", lambda: 0)
    hits = knot_hits(2**17)
    with pytest.raises(QueryError, match="ask for fewer hits at a time"):
        hits.interpolate(np.broadcast_to(1.0, (len(KNOT.vertices), 256)))


def test_chunks_leave_no_seams(monkeypatch):
    hits = scene_hits(1000)
    values = {0: KNOT.vertices, 1: BALLS.centres}
    expected = hits.interpolate(values)
    monkeypatch.setattr(module, "_CHUNK_HITS", 7)
    np.testing.assert_array_equal(hits.interpolate(values), expected)
