"""The hits of rays, nearest or all: however they are collected, where they are, and what is made of them."""

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import ConfigError, Hits, Mesh, QueryError, Scene, Spheres, Tracer
from clbvh.integrations.trimesh.ray import order_by_depth
from clbvh.structs import HIT
from clbvh.trace.hits import all_hits as module, interpolate as interpolate_module
from clbvh.trace.hits.refine import RefinedHits, refine_closest
from clbvh.trace.rays.batch import read_rays
from clbvh.trace.world.surface_arrays import lone_arrays

from ...rays import hard_rays

FIELDS = ("t", "u", "v", "prim_id")


@pytest.fixture(scope="module")
def expected(tracer, rays):
    hits = tracer.all_hits(*rays)
    assert hits.counts.max() >= 4
    assert (hits.counts == 0).sum() > 100
    return hits


def test_hits_are_in_the_order_of_t(tracer, rays, expected):
    assert (np.diff(expected.t)[np.diff(expected.ray_id) == 0] >= 0).all()
    closest = tracer.closest_hit(*rays)
    first = expected.offsets[:-1][closest.is_hit]
    for field in (*FIELDS, "locations", "normals"):
        np.testing.assert_array_equal(getattr(expected, field)[first], getattr(closest, field)[closest.is_hit])


def test_hits_in_a_scene_lie_on_the_instance_that_is_hit(open_tracer, world, rays):
    hits = open_tracer(world).all_hits(*rays)
    on_ray = rays[0][hits.ray_id] + hits.t[:, None] * rays[1][hits.ray_id]
    assert np.quantile(np.linalg.norm(on_ray - hits.locations, axis=1), 0.95) < 1e-12


@pytest.mark.parametrize("most", [None, 1, 2, 1000])
@pytest.mark.parametrize("slots", [(1, 2), (2, 3)], ids=str)
def test_max_hits_keeps_the_nearest_in_any_number_of_slots(tracer, rays, expected, monkeypatch, slots, most):
    monkeypatch.setattr(module, "FIRST_SLOTS", slots[0])
    monkeypatch.setattr(module, "SLOT_GROWTH", slots[1])
    hits = tracer.all_hits(*rays, max_hits=most, with_locations=True)
    kept = np.arange(len(expected)) - expected.offsets[expected.ray_id] < (most or np.inf)
    for field in ("t", "u", "v", "prim_id", "ray_id", "locations"):
        np.testing.assert_array_equal(getattr(hits, field), getattr(expected, field)[kept])
    counts = np.minimum(expected.counts, most or 2**31)
    np.testing.assert_array_equal(tracer.count_hits(*rays, max_hits=most), counts)
    order = np.lexsort((hits.ray_id, np.arange(len(hits)) - hits.offsets[hits.ray_id]))
    for obtained, by_depth in zip(order_by_depth(hits), (order, hits.ray_id[order]), strict=True):
        np.testing.assert_array_equal(obtained, by_depth)


def test_threads_share_the_hits(tracer, mesh, monkeypatch):
    """More hits than one thread is given, and each array as it is in one thread; rows in any layout."""
    rays = hard_rays(mesh, 60000, np.random.default_rng(12))
    expected = tracer.all_hits(*rays)
    assert len(expected) > 40000
    monkeypatch.setattr(module, "LEAST_HITS", 1000)
    monkeypatch.setattr(tracer._caster.threads, "count", 5)
    for with_locations in (False, True):
        hits = tracer.all_hits(*map(np.asfortranarray, rays), with_locations=with_locations)
        for field in (*FIELDS, "offsets", "locations"):
            assert getattr(hits, field).tobytes() == getattr(expected, field).tobytes(), field


def test_each_ray_keeps_its_limits_when_it_is_cast_again(tracer, rays, monkeypatch):
    monkeypatch.setattr(module, "FIRST_SLOTS", 1)
    generator = np.random.default_rng(12)
    # One array of numbers in a row, and one with gaps between them.
    limits = {
        "t_min": generator.uniform(0, 0.8, len(rays[0])),
        "t_max": generator.uniform(0.4, 2, 2 * len(rays[0]))[::2],
    }
    hits = tracer.all_hits(*rays, **limits)
    assert (hits.counts > 1).sum() > 100
    np.testing.assert_array_equal(hits.counts, tracer.count_hits(*rays, **limits))
    assert (hits.t >= limits["t_min"][hits.ray_id]).all()
    assert (hits.t <= limits["t_max"][hits.ray_id]).all()
    # Also where they are those of hits.
    closest = tracer.closest_hit(*rays)
    t = np.where(closest.is_hit, closest.t, 0)
    for low, high in ((t, np.inf), (0, t)):
        hits = tracer.closest_hit(*rays, t_min=low, t_max=high)
        assert ((hits.t >= low) & (hits.t <= high))[hits.is_hit].all()


def test_the_hit_of_one_ray_is_a_number_without_a_length(tracer):
    hits = tracer.closest_hit([0.725, 0.01, 5], [0, 0, -1])
    assert bool(hits.is_hit)
    assert hits.count == 1
    assert hits.locations.shape == (3,)
    for function in (len, bool, list):
        with pytest.raises(TypeError, match=r"ask for hits\.is_hit$"):
            function(hits)
    assert tracer.all_hits([0.725, 0.01, 5], [0, 0, -1]).offsets.shape == (2,)


def test_hits_are_chosen_as_arrays_are(tracer, rays):
    hits = tracer.closest_hit(*(array[:72].reshape(9, 8, 3) for array in rays))
    assert 0 < hits.count < hits.prim_id.size
    for index in (hits.is_hit, 3, (2, 5), slice(1, 4), np.array([1, 1, 0]), (slice(None), 2), ...):
        chosen = hits[index]
        for field in (*FIELDS, "is_front"):
            assert isinstance(getattr(chosen, field), np.ndarray)
            np.testing.assert_array_equal(getattr(chosen, field), getattr(hits, field)[index])
        np.testing.assert_array_equal(chosen.locations, hits.locations[index])
    assert [row.shape for row in hits] == [(8,)] * 9
    with pytest.raises(IndexError):
        hits[9]


def test_hits_are_of_the_ray_as_given(tracer, rays):
    """Not of the one that is rounded to float32 for the device."""
    generator = np.random.default_rng(34)
    origins, directions = (array + generator.uniform(-1e-3, 1e-3, array.shape) for array in rays)
    hits = tracer.closest_hit(origins, directions)
    found = np.flatnonzero(hits.is_hit)
    on_ray = origins[found] + hits.t[found, None] * directions[found]
    assert np.quantile(np.linalg.norm(on_ray - hits.locations[found], axis=1), 0.99) < 1e-13


@pytest.mark.parametrize("transform", [np.diag([1, -2, 1, 1]), np.diag([-1, -1, 3, 1])], ids=["mirror", "turn"])
def test_the_side_of_a_hit_is_that_of_its_normal(open_tracer, mesh, rays, transform):
    scene = Scene()
    scene.place(scene.add(mesh), transform)
    hits = open_tracer(scene).all_hits(*rays)
    is_against = (hits.normals * rays[1][hits.ray_id]).sum(axis=1) < 0
    assert 0.2 < is_against.mean() < 0.8
    assert (hits.is_front == is_against).mean() > 0.999


def test_a_hit_beside_its_triangle_moves_onto_it():
    """To (u, v) of its nearest point, from points in the plane: inside, beside each edge, and behind each corner."""
    mesh = Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    little = 2.0**-30
    beside = [(1, 2, 0.25, 0.5), (1, -little, 0.25, 0), (-little, 1, 0, 0.25), (1 + little, 3 + little, 0.25, 0.75)]
    beside += [(3 + little, 1 + little, 0.75, 0.25), (-little, -little, 0, 0), (4 + 2 * little, 0, 1, 0)]
    beside += [(4 + little, -3 * little, 1, 0), (0, 4 + 2 * little, 0, 1)]
    for x, y, u, v in beside:
        for length in (1.0, 3.0):
            rays = read_rays(np.array([[x, y, 3.0]]), np.array([[0, 0, -length]]), 0.0, np.inf)
            hits = RefinedHits.make(1)
            refine_closest(rays, 0, lone_arrays(mesh), np.zeros(1, HIT), hits)
            np.testing.assert_allclose([hits.u[0], hits.v[0]], [u, v], rtol=0, atol=1e-9, err_msg=f"{x}, {y}")
            assert min(hits.u[0], hits.v[0], 1 - hits.u[0] - hits.v[0]) >= 0
            assert hits.t[0] == pytest.approx(3 / length)


def test_a_ray_in_the_plane_of_its_triangle_is_hit_where_it_passes():
    """Where rounding alone says from which side: quotients of such numbers are noise."""
    generator, count = np.random.default_rng(7), 1000
    corners = generator.normal(size=(count, 3, 3))
    starts, targets = np.einsum("inc,ncx->inx", generator.dirichlet([1, 1, 1], (2, count)), corners)
    rays = read_rays(starts, targets - starts, 0.0, np.inf)
    mesh = Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    found, hits = np.zeros(count, HIT), RefinedHits.make(count)
    found["prim_id"] = np.arange(count)
    refine_closest(rays, 0, lone_arrays(mesh), found, hits)
    shares = np.stack((1 - hits.u - hits.v, hits.u, hits.v), axis=1)
    away = np.einsum("nc,ncx->nx", shares, corners) - starts - hits.t[:, None] * (targets - starts)
    assert np.linalg.norm(away, axis=1).max() < 1e-9


def interpolate_by_hand(hits, mesh, values):
    shares = np.stack((1 - hits.u - hits.v, hits.u, hits.v), axis=-1)
    expected = np.einsum("...k,...kl->...l", shares, values[mesh.faces[hits.prim_id % mesh.face_count]])
    return np.where(hits.is_hit[..., None], expected, np.nan)


def test_values_at_vertices_give_locations_constants_and_nan(tracer, mesh, rays):
    hits = tracer.closest_hit(*rays)
    for values in (mesh.vertices, {0: mesh.vertices}, {"knot": mesh.vertices}):
        assert hits.interpolate(values).tobytes() == hits.locations.tobytes()
    assert (hits[hits.is_hit].interpolate([0.1] * len(mesh.vertices)) == 0.1).all()
    for index, shape in ((0, ()), (slice(0), (0,))):
        assert hits[index].interpolate(mesh.vertices.reshape(-1, 3, 1)).shape == (*shape, 3, 1)
    whole = np.random.default_rng(1).integers(0, 100, len(mesh.vertices))
    for dtype in ("float16", "uint64"):
        assert hits.interpolate(whole.astype(dtype)).tobytes() == hits.interpolate(whole * 1.0).tobytes()
    values = np.where(np.arange(len(mesh.vertices)) == mesh.faces[hits.prim_id.max(), 0], np.nan, 1.0)
    touches = np.isnan(values[mesh.faces[hits.prim_id]]).any(axis=1)
    np.testing.assert_array_equal(np.isnan(hits.interpolate(values)), touches | ~hits.is_hit)


@pytest.fixture(scope="module")
def scene_hits(open_tracer, world, rays):
    return open_tracer(world).closest_hit(*rays)


def test_scenes_take_a_mapping_of_geometries(mesh, world, scene_hits, monkeypatch):
    knot, balls = world.geometries
    temperatures = np.random.default_rng(2).normal(size=(20, 3))
    on_knot, on_balls = (scene_hits.geometry_id == geometry.id for geometry in (knot, balls))
    expected = np.where(on_knot[:, None], interpolate_by_hand(scene_hits, mesh, mesh.vertices), np.nan)
    expected[on_balls] = temperatures[scene_hits.prim_id[on_balls]]
    for one, other in ((0, 1), (knot.name, balls.name), (np.int64(0), balls)):
        result = scene_hits.interpolate({one: mesh.vertices, other: temperatures})
        np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(np.isnan(scene_hits.interpolate({balls: np.ones(20)})), ~on_balls)
    assert np.isnan(scene_hits.interpolate({})).all()
    monkeypatch.setattr(interpolate_module, "_CHUNK_HITS", 7)
    np.testing.assert_array_equal(scene_hits.interpolate({0: mesh.vertices, 1: temperatures}), result)


def test_wrong_values_are_refused(mesh, scene_hits, monkeypatch):
    count = len(mesh.vertices)
    for values, message in (
        (np.ones(20), "the scene has 2 geometries: give the values as a mapping"),
        ({"car": np.ones(20)}, "no geometry with the name 'car', but 'knot', 'spheres'"),
        ({2: np.ones(20)}, "no geometry with the id 2: there are 2"),
        ({"spheres": np.ones(20), 1: np.ones(20)}, "values for the geometry 'spheres' twice"),
        ({1: np.ones(19)}, r"spheres: there must be one value or row for each of the 20 spheres, not \(19,\)"),
        ({0: np.ones((count, 2)), 1: np.ones(20)}, rf"'knot': \({count}, 2\), 'spheres': \(20,\)"),
        ({1: np.ma.masked_equal(np.arange(20), 3)}, "some are masked"),
    ):
        with pytest.raises(QueryError, match=message):
            scene_hits.interpolate(values)
    with pytest.raises(ConfigError, match="do not know their mesh"):
        Hits(*np.zeros((3, 1)), np.zeros(1, np.int32)).interpolate([1.0])
    monkeypatch.setattr("clbvh.support.memory.free_memory_bytes", lambda: 0)
    with pytest.raises(QueryError, match="ask for fewer hits at a time"):
        scene_hits[np.zeros(2**17, int)].interpolate({0: np.broadcast_to(1.0, (count, 256))})


def test_hits_that_a_surface_does_not_have_are_refused(mesh):
    for prim_id in (-2, mesh.face_count):
        hits = Hits(np.ones(2), np.zeros(2), np.zeros(2), np.array([prim_id, 0], np.int32), mesh=mesh)
        with pytest.raises(QueryError, match="their surface does not have"):
            hits.locations  # noqa: B018


def test_sides_may_be_numbers(mesh):
    values = np.ones(2), np.full(2, 0.2), np.full(2, 0.3), np.array([0, 1], np.int32)
    expected = Hits(*values, mesh=mesh, is_front=np.array([True, False])).offset_origins()
    assert (Hits(*values, mesh=mesh, is_front=np.array([1, 0])).offset_origins() == expected).all()


def test_points_of_spheres_at_no_number_are_none(session):
    scene = Scene(Spheres([[0.0, 0.0, 0.0]], 1.0))
    with Tracer(scene, device=session.info) as tracer:
        hits = tracer.closest_hit([[0, 0, 9]], [[0, 0, -1]])
    for lost in (np.nan, np.inf):
        for coordinate in (hits.u, hits.v):
            kept, coordinate[0] = coordinate[0], lost
            assert np.isnan(hits.locations).any()
            coordinate[0] = kept


def test_spheres_of_any_size_and_distance_are_hit_at_their_distance(session):
    spheres = Spheres([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]], [1.0, 1e-320])
    with Tracer(Scene(spheres), device=session.info) as tracer:
        assert tracer.closest_hit([[5.0, 0, 0]], [[1e280, 0, 0]]).t.tolist() == [0.0]
    with Tracer(Scene(Spheres([[0.0, 0.0, 0.0]], 1e100)), device=session.info) as tracer:
        assert tracer.closest_hit([[1e300, 0, 0]], [[-1e-320, 0, 0]]).t > 1e308


@pytest.mark.parametrize("suffix", [".ply", ".las", ".laz"])
def test_saved_hits_are_points_with_their_rays(session, tmp_path, suffix):
    if suffix != ".ply":
        pytest.importorskip("laspy")
    if suffix == ".laz":
        pytest.importorskip("lazrs")
    scene = clbvh.Scene()
    ball = scene.add(clbvh.make_shape("icosphere", triangles=320))
    scene.place(ball)
    scene.place(ball, clbvh.Transform(translate=(500_000, 4_000_000, 0)))
    origins = np.array([[0.1, 0.2, 5], [9, 9, 9], [500_000.1, 4_000_000.2, 5]])
    with clbvh.Tracer(scene) as tracer:
        hits, all_hits = (ask(origins, [0, 0, -1]) for ask in (tracer.closest_hit, tracer.all_hits))
    for found, rays in ((hits, [0, 2]), (all_hits, [0, 0, 2, 2])):
        path = tmp_path / f"scan{suffix}"
        found.save(path)
        if suffix == ".ply":
            data = trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]
        else:
            import laspy

            data = laspy.read(path)
        kept = found.take(np.flatnonzero(found.is_hit))
        points = np.stack([np.asarray(data[axis]) for axis in "xyz"], axis=1)
        np.testing.assert_allclose(points, kept.locations, rtol=0, atol=0 if suffix == ".ply" else 4e-3)
        normals = np.stack([np.asarray(data[axis]) for axis in ("nx", "ny", "nz")], axis=1)
        assert (normals[:, 2] > 0).all()  # towards where the rays come from, also inside
        assert np.asarray(data["ray_id"]).tolist() == rays
        assert np.asarray(data["prim_id"]).tolist() == kept.prim_id.tolist()
        assert np.asarray(data["instance_id"]).tolist() == kept.instance_id.tolist()
        np.testing.assert_array_equal(np.asarray(data["t"]), kept.t)
    with pytest.raises(clbvh.ConfigError, match=r"must end in \.ply, \.las, \.laz"):
        hits.save(tmp_path / "scan.xyz")


def test_a_table_of_an_image_has_one_axis(session):
    with clbvh.Tracer(clbvh.make_shape("icosphere", triangles=320)) as tracer:
        hits = tracer.closest_hit(*clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0)).rays(8, 6))
    assert {values.shape for values in hits.to_dict().values()} == {(48,)}
