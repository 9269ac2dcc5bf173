"""The arrays of hits: what they hold, how they are chosen from, and values of vertices and spheres at them."""

import numpy as np
import pytest

from clbvh import ConfigError, Mesh, QueryError, Spheres, Tracer, make_shape
from clbvh.structs import HIT, NO_PRIM, WORLD_HIT
from clbvh.trace.hits import interpolate as module
from clbvh.trace.hits.hits import Hits
from clbvh.trace.hits.refine import RefinedHits, refine_closest
from clbvh.trace.hits.surface import Surface
from clbvh.trace.rays.batch import read_rays
from clbvh.trace.world.surface_arrays import lone_arrays, make_surface_arrays

FIELDS = ("t", "u", "v", "prim_id", "is_front")


@pytest.fixture(scope="module")
def balls():
    return Spheres(np.random.default_rng(0).normal(size=(20, 3)), 0.25)


@pytest.fixture(scope="module")
def mesh_hits(mesh):
    """A function from a shape to hits of the knot, and misses."""

    def make(*shape):
        generator = np.random.default_rng(0)
        u, v = generator.uniform(0, 0.5, (2, *shape))
        return Hits(u, u, v, generator.integers(-1, mesh.face_count, shape).astype(np.int32), mesh)

    return make


@pytest.fixture(scope="module")
def scene_hits(mesh, balls):
    """3,000 hits and misses of a scene of the knot and 20 spheres, which are placed twice."""
    generator = np.random.default_rng(0)
    surface = Surface.from_shapes([mesh, balls], ["knot", "balls"], np.array([1, 0, 1]), np.stack([np.eye(4)] * 3))
    u, v = generator.uniform(0, 0.5, (2, 3000))
    instance_id = generator.integers(-1, 3, 3000).astype(np.int32)
    prim_id = np.where(instance_id == -1, -1, generator.integers(0, 20, 3000)).astype(np.int32)
    return Hits(u, u, v, prim_id, surface=surface, known_instance_id=instance_id)


def test_fields_are_views_of_the_device_array():
    raw = np.array([(1.5, 0.25, 0.5, 0), (np.inf, 0, 0, NO_PRIM), (2.0, 0, 1, 7), (0.0, 0, 0, 3)], HIT)
    hits = Hits(*(raw[name] for name in HIT.names))
    for name in HIT.names:
        np.testing.assert_array_equal(getattr(hits, name), raw[name])
        assert np.shares_memory(getattr(hits, name), raw)
    assert hits.is_hit.tolist() == [True, False, True, True]
    assert (len(hits), hits.count) == (4, 3)
    taken = Hits(*(raw[name].reshape(2, 2) for name in HIT.names)).take(np.array([3, 0, 0]))
    assert [getattr(taken, name).tolist() for name in HIT.names] == [
        raw[name][[3, 0, 0]].tolist() for name in HIT.names
    ]
    with pytest.raises(AttributeError):
        hits.t = raw["u"]


def test_hits_show_their_numbers_and_no_arrays(session):
    with Tracer(make_shape("icosphere", triangles=80), device=session.info) as tracer:
        along, past = [[1, 0, 0]] * 2000, np.arange(6000).reshape(2000, 3)
        assert repr(tracer.closest_hit([0, 0, 0], along)) == "Hits(shape=(2000,), hits=2,000)"
        assert repr(tracer.closest_hit([0, 0, 0], [1, 0, 0])) == "Hits(shape=(), hits=1)"
        assert repr(tracer.all_hits([[-5, 0.1, 0.1], [-5, 7, 0]], [1, 0, 0])) == "AllHits(rays=2, hits=2)"
        assert repr(tracer.closest_point(past)) == "ClosestPoints(shape=(2000,), found=2,000)"


def test_the_hit_of_one_ray_is_a_number_without_a_length(tracer):
    hits = tracer.closest_hit([0.725, 0.01, 5], [0, 0, -1])
    assert bool(hits.is_hit)
    assert hits.count == 1
    assert hits.locations.shape == (3,)
    for function in (len, bool, list):
        with pytest.raises(TypeError, match=r"ask for hits\.is_hit$"):
            function(hits)
    crossings = tracer.all_hits([0.725, 0.01, 5], [0, 0, -1])
    assert crossings.offsets.tolist() == [0, len(crossings)]


def test_hits_are_chosen_as_arrays_are(tracer, rays):
    hits = tracer.closest_hit(*(array[:72].reshape(9, 8, 3) for array in rays))
    assert 0 < hits.count < hits.prim_id.size
    for index in (hits.is_hit, 3, (2, 5), slice(1, 4), np.array([1, 1, 0]), (slice(None), 2), ...):
        chosen = hits[index]
        for field in FIELDS:
            assert isinstance(getattr(chosen, field), np.ndarray)
            np.testing.assert_array_equal(getattr(chosen, field), getattr(hits, field)[index])
        np.testing.assert_array_equal(chosen.locations, hits.locations[index])
    assert [row.shape for row in hits] == [(8,)] * 9
    with pytest.raises(IndexError):
        hits[9]


def test_hits_are_of_the_ray_as_given(tracer, mesh, rays):
    """Not of the one that is rounded to float32 for the device."""
    generator = np.random.default_rng(34)
    origins, directions = (array + generator.uniform(-1e-3, 1e-3, array.shape) for array in rays)
    hits = tracer.closest_hit(origins, directions)
    found = np.flatnonzero(hits.is_hit)
    on_ray = origins[found] + hits.t[found, None] * directions[found]
    assert np.quantile(np.linalg.norm(on_ray - hits.locations[found], axis=1), 0.99) < 1e-13
    assert np.isnan(hits.locations[~hits.is_hit]).all()
    a, b, c = mesh.vertices[mesh.faces[hits.prim_id[found]]].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    np.testing.assert_allclose(hits.normals[found], normals, atol=1e-13)


def test_a_hit_beside_its_triangle_moves_onto_it():
    """To (u, v) of its nearest point, from points in the plane: inside, beside each edge, and behind each corner."""
    mesh = Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    little = 2.0**-30
    for x, y, u, v in (
        (1, 2, 0.25, 0.5),
        (1, -little, 0.25, 0),
        (-little, 1, 0, 0.25),
        (1 + little, 3 + little, 0.25, 0.75),
        (3 + little, 1 + little, 0.75, 0.25),
        (-little, -little, 0, 0),
        (4 + 2 * little, 0, 1, 0),
        (4 + little, -3 * little, 1, 0),
        (0, 4 + 2 * little, 0, 1),
    ):
        for length in (1.0, 3.0):
            rays, _ = read_rays(np.array([[x, y, 3.0]]), np.array([[0, 0, -length]]), 0.0, np.inf)
            hits = RefinedHits.make(1)
            refine_closest(rays.part(0, 1), lone_arrays(mesh), np.zeros(1, HIT), hits)
            np.testing.assert_allclose([hits.u[0], hits.v[0]], [u, v], rtol=0, atol=1e-9, err_msg=f"{x}, {y}")
            assert min(hits.u[0], hits.v[0], 1 - hits.u[0] - hits.v[0]) >= 0
            assert hits.t[0] == pytest.approx(3 / length)


@pytest.mark.parametrize("is_second", [False, True])
def test_hits_on_a_lone_shape_are_those_on_its_instance_in_the_same_place(mesh, balls, is_second):
    generator = np.random.default_rng(8)
    for shape, other in ((mesh, balls), (balls, mesh)):
        # Ten misses; more hits than a block has, and not a multiple.
        prims = np.r_[np.full(10, -1), generator.integers(0, shape.prim_count, 290)]
        rays, _ = read_rays(*generator.normal(size=(2, 300, 3)), 0.0, np.inf)
        shapes, results = [other, shape] if is_second else [shape], []
        placed = make_surface_arrays(shapes, np.array([len(shapes) - 1]), np.eye(4)[None])
        for arrays, dtype in ((lone_arrays(shape), HIT), (placed, WORLD_HIT)):
            found, hits = np.zeros(300, dtype), RefinedHits.make(300, is_lone=arrays.is_lone)
            found["prim_id"], found["u"] = prims, np.arange(300) % 2
            refine_closest(rays.part(0, 300), arrays, found, hits)
            results.append(hits)
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(results[0], name), getattr(results[1], name), err_msg=name)
        assert len(results[0].instance_id) == 0
        np.testing.assert_array_equal(results[1].instance_id, np.minimum(prims, 0))


@pytest.mark.parametrize("dtype", ["float64", "float16", "uint64", "bool"])
@pytest.mark.parametrize("width", [(), (1,), (2, 3), (0,)])
def test_values_of_any_width_and_type_are_interpolated(mesh, mesh_hits, width, dtype):
    values = np.random.default_rng(1).uniform(0, 100, (len(mesh.vertices), *width)).astype(dtype)
    hits = mesh_hits(5, 10)
    result = hits.interpolate(values)
    assert result.shape == (5, 10, *width)
    assert result.dtype == np.float64
    shares = np.stack((1 - hits.u - hits.v, hits.u, hits.v), axis=-1)
    expected = np.einsum("ijk,ijk...->ij...", shares, values[mesh.faces[hits.prim_id]].astype(np.float64))
    expected[~hits.is_hit] = np.nan
    np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-12)


def test_values_at_vertices_give_locations_constants_and_nan(mesh, mesh_hits):
    hits = mesh_hits(40_000)
    assert hits.interpolate(mesh.vertices).tobytes() == hits.locations.tobytes()
    assert (hits[hits.is_hit].interpolate([0.1] * len(mesh.vertices)) == 0.1).all()
    assert mesh_hits().interpolate(mesh.vertices).shape == (3,)
    assert mesh_hits(0).interpolate(mesh.vertices).shape == (0, 3)
    values = np.where(np.arange(len(mesh.vertices)) == 7, np.nan, 1.0)
    touches = (mesh.faces[hits.prim_id] == 7).any(axis=1)
    np.testing.assert_array_equal(np.isnan(hits.interpolate(values)), touches | ~hits.is_hit)


class Handle:
    def __init__(self, number):
        self.id = number


def test_scenes_take_a_mapping_of_geometries(mesh, scene_hits, monkeypatch):
    temperatures = np.random.default_rng(2).normal(size=(20, 3))
    on_knot, on_balls = scene_hits.geometry_id == 0, scene_hits.geometry_id == 1
    expected = np.full((3000, 3), np.nan)
    expected[on_knot] = scene_hits.locations[on_knot]
    expected[on_balls] = temperatures[scene_hits.prim_id[on_balls]]
    for one, other in ((0, 1), ("knot", "balls"), (np.int64(0), Handle(1))):
        np.testing.assert_array_equal(scene_hits.interpolate({one: mesh.vertices, other: temperatures}), expected)
    np.testing.assert_array_equal(np.isnan(scene_hits.interpolate({"balls": np.ones(20)})), ~on_balls)
    assert np.isnan(scene_hits.interpolate({})).all()
    monkeypatch.setattr(module, "_CHUNK_HITS", 7)
    np.testing.assert_array_equal(scene_hits.interpolate({0: mesh.vertices, 1: temperatures}), expected)


def test_a_mesh_is_a_scene_of_one_geometry(mesh, balls, mesh_hits):
    hits = mesh_hits(100)
    for key in (0, "knot", Handle(0)):
        np.testing.assert_array_equal(hits.interpolate({key: mesh.vertices}), hits.locations)
    surface = Surface.from_shapes([balls, mesh], ["a", "b"], np.array([1]), None)
    in_scene = Hits(hits.t, hits.u, hits.v, hits.prim_id, surface=surface)
    assert in_scene.mesh is mesh
    assert in_scene.locations.tobytes() == hits.locations.tobytes()
    np.testing.assert_array_equal(in_scene.instance_id, np.minimum(hits.prim_id, 0))
    np.testing.assert_array_equal(in_scene.geometry_id, np.where(hits.is_hit, 1, -1))
    np.testing.assert_array_equal(in_scene.interpolate({"b": mesh.vertices}), hits.locations)
    assert np.isnan(in_scene.interpolate({"a": np.ones(20)})).all()


def test_wrong_values_are_refused(mesh, scene_hits, mesh_hits, monkeypatch):
    count = len(mesh.vertices)
    for values, message in (
        (np.ones(20), "the scene has 2 geometries: give the values as a mapping"),
        ({"car": np.ones(20)}, "no geometry with the name 'car', but 'knot', 'balls'"),
        ({2: np.ones(20)}, "no geometry with the id 2: there are 2"),
        ({-1: np.ones(20)}, "no geometry with the id -1"),
        ({True: np.ones(20)}, "not for True"),
        ({1.5: np.ones(20)}, r"not for 1\.5"),
        ({"balls": np.ones(20), 1: np.ones(20)}, "values for the geometry 'balls' twice"),
        ({"balls": np.ones(19)}, r"balls: there must be one value or row for each of the 20 spheres, not \(19,\)"),
        ({"knot": np.ones((count, 2)), "balls": np.ones(20)}, rf"'knot': \({count}, 2\), 'balls': \(20,\)"),
        ({"knot": 1.0}, rf"each of the {count} vertices, not \(\)"),
        ({"balls": ["x"] * 20}, "real numbers, not <U1"),
        ({"balls": np.ones(20, complex)}, "real numbers, not complex128"),
        ({"balls": [[1], [1, 2]]}, "rows differ in length"),
        ({"balls": np.ma.masked_equal(np.arange(20), 3)}, "some are masked"),
    ):
        with pytest.raises(QueryError, match=message):
            scene_hits.interpolate(values)
    with pytest.raises(ConfigError, match="do not know their mesh"):
        Hits(*np.zeros((3, 1)), np.zeros(1, np.int32)).interpolate([1.0])
    monkeypatch.setattr("clbvh.support.memory.free_memory_bytes", lambda: 0)
    with pytest.raises(QueryError, match="ask for fewer hits at a time"):
        mesh_hits(2**17).interpolate(np.broadcast_to(1.0, (count, 256)))
