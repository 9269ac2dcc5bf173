"""Start points of rays that leave a surface: they never meet what they leave."""

import numpy as np
import pytest

from clbvh import ConfigError, Hits, Mesh, QueryError, Scene, Spheres, Tracer, make_shape
from clbvh.structs import NO_PRIM

from .scene_states import affine

RAYS = 4000
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]


def turn(generator):
    return np.linalg.qr(generator.normal(size=(3, 3)))[0]


def make_soup(generator, low=0, high=0):
    """Triangles of all sizes; their third corner is about 10^low to 10^high edges away from the first edge."""
    a = generator.normal(size=(200, 3))
    ab = generator.normal(size=(200, 3)) * 10.0 ** generator.uniform(-6, 0, (200, 1))
    widths = np.abs(ab).max(axis=1, keepdims=True) * 10.0 ** generator.uniform(low, high, (200, 1))
    c = a + ab * generator.random((200, 1)) + generator.normal(size=(200, 3)) * widths
    return Mesh.from_arrays(np.stack([a, a + ab, c], axis=1).reshape(-1, 3), np.arange(600).reshape(-1, 3))


SHAPES = {
    "soup": make_soup,
    "slivers": lambda generator: make_soup(generator, -8, -3),
    "needles": lambda generator: make_soup(generator, -20, -8),
    "knot": lambda generator: make_shape("knot", triangles=2000),
    "spheres": lambda generator: Spheres(generator.normal(size=(200, 3)), 10 ** generator.uniform(-3, -0.5, 200)),
}

MAPS = {
    "rotation": turn,
    "mirror": lambda generator: turn(generator) @ np.diag([1, 1, -1]) @ turn(generator),
    "stretch": lambda generator: turn(generator) @ np.diag(10 ** generator.uniform(-2, 2, 3)) @ turn(generator),
    "flattened": lambda generator: turn(generator) @ np.diag([1, 1, 10 ** generator.uniform(-12, -4)]),
    "needle": lambda generator: turn(generator) @ np.diag([1e-5, 1e-8, 1]),
    "shear": lambda generator: turn(generator) @ [[1, 100, 0], [0, 1, 0], [0, 0, 1]] @ turn(generator),
}


def make_source(shape, name, far, size, generator):
    """A shape alone, or several instances of it; of this size, and this many sizes from zero."""
    if name == "alone":
        if isinstance(shape, Spheres):
            return Scene(Spheres((shape.centres + far) * size, shape.radii * size))
        return Scene(Mesh.from_arrays((shape.vertices + far * generator.normal(size=3)) * size, shape.faces))
    scene = Scene()
    geometry = scene.add(shape)
    for _ in range(4):
        scene.place(geometry, affine(MAPS[name](generator) * size, (2 * generator.normal(size=3) + far) * size))
    return scene


def make_hits(tracer, scene, generator, count=RAYS):
    """Hits of rays at points of primitives, many of them close to edges and inside of spheres, from near and far."""
    shape, transforms = scene.geometries[0].shape, scene.snapshot().transforms
    prims = generator.integers(shape.prim_count, size=count)
    if isinstance(shape, Spheres):
        outwards = generator.normal(size=(count, 3)) * generator.choice([1, 0.9999, 0.5], (count, 1))
        outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
        targets = shape.centres[prims] + shape.radii[prims, None] * outwards
    else:
        weights = generator.dirichlet(np.full(3, 0.4), count)
        targets = (weights[:, :, None] * shape.vertices[shape.faces[prims]]).sum(axis=1)
    chosen = transforms[generator.integers(len(transforms), size=count)]
    targets = np.einsum("nij,nj->ni", chosen[:, :3, :3], targets) + chosen[:, :3, 3]
    size = np.abs(transforms[:, :3, :3]).max() * np.ptp(shape.vertices if isinstance(shape, Mesh) else shape.centres)
    away = generator.normal(size=(count, 3)) * size * 10.0 ** generator.uniform(-2, 1, (count, 1))
    hits = tracer.closest_hit(targets + away, -away)
    return hits[hits.is_hit]


def make_directions(normals, generator):
    """Directions of any length over the half space of each normal, many of them along its plane."""
    directions = generator.normal(size=normals.shape)
    heights = (directions * normals).sum(axis=1, keepdims=True)
    flatness = generator.choice([1.0, 1e-3, 1e-6, 1e-9, 0.0], (len(normals), 1))
    directions += (flatness * np.abs(heights) - heights) * normals
    return directions * 10.0 ** generator.uniform(-20, 20, (len(normals), 1))


def count_own(tracer, hits, origins, directions):
    """How often each ray crosses the primitive that it leaves, at most 1 if only the closest hit says so."""
    crossings, closest = tracer.all_hits(origins, directions), tracer.closest_hit(origins, directions)
    ray_id = crossings.ray_id
    is_own = (crossings.prim_id == hits.prim_id[ray_id]) & (crossings.instance_id == hits.instance_id[ray_id])
    is_closest = (closest.prim_id == hits.prim_id) & (closest.instance_id == hits.instance_id)
    return np.maximum(np.bincount(ray_id[is_own], minlength=len(hits)), is_closest)


def find_hopeless(hits, origins, is_inside):
    """Which start points are in spheres too small for them: they may have moved to the centre.

    How far they have moved is known to the rounding of their world coordinates.
    """
    inverse = hits.surface.arrays.inverse[hits.instance_id]
    moved = np.linalg.norm(np.einsum("nij,nj->ni", inverse, origins - hits.locations), axis=1)
    noise = np.linalg.norm(np.einsum("nij,nj->ni", np.abs(inverse), 2.0**-51 * np.abs(origins)), axis=1)
    return is_inside & (moved + noise > 0.99 * hits.surface.arrays.solids.reshape(-1, 4)[hits.prim_id, 3])


@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("name", ["alone", *MAPS])
def test_rays_do_not_meet_the_primitive_that_they_leave(session, kind, name):
    is_sphere = kind == "spheres"
    far_ones = (1e7,) if name != "alone" else (1e4,) if is_sphere else (1e3, 1e9, 1e13)
    for far, size in [(0.0, 1.0), *((far, size) for far in far_ones for size in (1e-30, 1.0, 1e30))]:
        generator = np.random.default_rng(19)
        scene = make_source(SHAPES[kind](generator), name, far, size, generator)
        with Tracer(scene, device=session.info) as tracer:
            hits = make_hits(tracer, scene, generator)
            # Float64 decides about far needles: many are thinner than the rounding of the rays that are aimed at them.
            assert len(hits) > 20 or (kind == "needles" and far)
            # On the side of the ray; and through the surface, on the side to which a direction leads.
            above = make_directions(hits.normals(facing=True), generator)
            towards = generator.normal(size=(len(hits), 3))
            heights = (towards * hits.normals).sum(axis=1, keepdims=True)
            if not is_sphere:
                towards -= generator.choice([0.0, 0.999999, 1.0], heights.shape) * heights * hits.normals
            for origins, directions, is_inside in (
                (hits.offset_origins(), above, ~hits.is_front),
                (hits.offset_origins(towards=towards), towards, heights[:, 0] < 0),
            ):
                count = count_own(tracer, hits, origins, directions)
                # From inside of a sphere, every ray leaves it once.
                is_known = ~find_hopeless(hits, origins, is_inside) if is_sphere else np.ones(len(hits), bool)
                np.testing.assert_array_equal(count[is_known], (is_inside & is_sphere)[is_known], str((far, size)))
            if (name, size) == ("rotation", 1.0) and kind in ("soup", "spheres"):
                # Start points are close, but for the rounding of a far scene; and the rays are hard ones.
                leaps, shape = np.linalg.norm(hits.offset_origins() - hits.locations, axis=1), scene.geometries[0].shape
                assert (leaps > 0).all()
                assert leaps.max() < max(1e-3 if far else 0, 6e-5 * np.abs(shape.local_box).max() / shape.scale)
                front = hits[hits.is_front]
                own = count_own(tracer, front, front.locations, make_directions(front.normals, generator))
                assert (own > 0).mean() > 0.1


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
def test_rays_that_leave_a_convex_mesh_meet_nothing(session, size):
    generator, ball = np.random.default_rng(17), make_shape("icosphere", triangles=1280)
    vertices = ball.vertices * [1, 0.2, 3] @ turn(generator) + generator.normal(size=3)
    scene = Scene(Mesh.from_arrays(vertices * size, ball.faces))
    with Tracer(scene, device=session.info) as tracer:
        hits = make_hits(tracer, scene, generator, 20_000)
        hits = hits[hits.is_front]
        assert len(hits) > 5000
        directions = make_directions(hits.normals(facing=True), generator)
        assert not tracer.any_hit(hits.offset_origins(), directions).any()
        # The rays are hard ones: without an offset, many meet the mesh.
        assert tracer.any_hit(hits.locations, directions).mean() > 0.01


@pytest.fixture(scope="module")
def triangle(_opened_device):
    with Tracer(TRIANGLE, device=_opened_device.info) as opened:
        yield opened


class TestSides:
    def test_points_are_close_to_the_surface_and_on_the_side_of_the_ray(self, triangle):
        origins, directions = [[0.2, 0.2, 1], [0.2, 0.2, -1], [5, 5, 5]], [[0, 0, -1], [0, 0, 1], [0, 0, 1]]
        hits, crossings = triangle.closest_hit(origins, directions), triangle.all_hits(origins, directions)
        assert hits.is_front.tolist() == [True, False, False]
        assert crossings.is_front.tolist() == [True, False]
        points = crossings.offset_origins()
        np.testing.assert_array_equal(points[:, :2], crossings.locations[:, :2])
        assert (points[:, 2] > 0).tolist() == [True, False]
        assert (np.abs(points[:, 2]) < 1e-5).all()

    def test_towards_broadcasts(self, triangle):
        hits = triangle.closest_hit([[0.2, 0.2, 1], [0.3, 0.3, -1]], [[0, 0, -1], [0, 0, 1]])
        directions = np.array([[0, 0, 1], [0, 0, -1], [1, 0, -1e-300], [5e-324, 0, 5e-324]])[:, None]
        points = hits.offset_origins(towards=directions)
        assert (points[..., 2] > 0).tolist() == [[True, True], [False, False], [False, False], [True, True]]
        assert hits.offset_origins(towards=[0, 0, 1]).shape == (2, 3)
        assert hits[0].offset_origins().shape == (3,)
        assert hits[0].offset_origins(towards=np.ones((7, 3))).shape == (7, 3)
        assert hits[[]].offset_origins().shape == hits[[]].offset_origins(towards=[0, 0, 1]).shape == (0, 3)

    def test_misses_are_nan_and_what_is_refused(self, triangle):
        hits = triangle.closest_hit([[0.2, 0.2, 1], [9, 9, 1]], [0, 0, -1])
        for points in (hits.offset_origins(), hits.offset_origins(towards=[0, 0, 1])):
            assert np.isnan(points).all(axis=1).tolist() == [False, True]
        given = np.array([[1.0, np.inf], [0.2, 0], [0.2, 0]]), np.array([0, NO_PRIM], np.int32)
        of_unknown_side = Hits(*given[0], given[1], Mesh.from_arrays(*TRIANGLE))
        assert of_unknown_side.offset_origins(towards=[0, 0, 1])[0, 2] > 0
        for call, error, words in (
            (lambda: triangle.any_hit(hits.offset_origins(), [0, 0, 1]), QueryError, "is not finite"),
            (lambda: hits.offset_origins(towards=np.ones((5, 3))), QueryError, "^towards must have a shape that broad"),
            (lambda: hits.offset_origins(towards=np.ones((2, 2))), QueryError, r"^towards must have shape \(3,\)"),
            (of_unknown_side.offset_origins, ConfigError, r"call offset_origins\(towards=directions\)$"),
        ):
            with pytest.raises(error, match=words):
                call()


@pytest.mark.parametrize("kind", ["soup", "needles", "knot"])
@pytest.mark.parametrize(("far", "size"), [(0.0, 1.0), (1e9, 1e-30), (1e6, 1e30)])
def test_points_that_no_ray_has_found_are_left_likewise(session, kind, far, size):
    generator = np.random.default_rng(5)
    mesh = make_source(SHAPES[kind](generator), "alone", far, size, generator).geometries[0].shape
    faces, towards = generator.integers(mesh.face_count, size=RAYS), generator.normal(size=(RAYS, 3))
    weights = generator.dirichlet(np.full(3, 0.4), RAYS)
    weights[: RAYS // 8] = np.eye(3)[generator.integers(3, size=RAYS // 8)]
    with Tracer(mesh, device=session.info) as tracer:
        origins = tracer.points_on(faces, weights).offset_origins(towards=towards)
        assert (origins == tracer.points_on(faces, weights[:, 1:]).offset_origins(towards=towards)).all()
        crossings = tracer.all_hits(origins, towards)
        assert not (crossings.prim_id == faces[crossings.ray_id]).any()
        assert (tracer.closest_hit(origins, towards).prim_id != faces).all()
        hits = make_hits(tracer, Scene(mesh), generator, 500)
        points = tracer.points_on(hits.prim_id, np.stack((hits.u, hits.v), axis=-1))
    away = hits.normals(facing=True)
    found = points.offset_origins(towards=away)
    assert found.tobytes() == hits.offset_origins(towards=away).tobytes()


def test_points_and_directions_broadcast_and_wrong_ones_are_refused():
    with Tracer(TRIANGLE) as tracer:
        assert tracer.points_on(0).offset_origins(towards=[0, 0, 1]).shape == (3,)
        points = tracer.points_on([[0], [0]], [0.5, 0.5])
        assert points.offset_origins(towards=np.ones((2, 4, 3))).shape == (2, 4, 3)
        for faces, weights, towards, words in (
            (1, [0, 0], [0, 0, 1], "prim_id must be whole numbers from 0 to 0"),
            (0, [0.5, 0.6], [0, 0, 1], "barycentrics must be"),
            (0, [0.9, 0.3, 0.3], [0, 0, 1], "barycentrics must be"),
            ([0, 0], np.zeros((3, 2)), [0, 0, 1], "do not broadcast"),
            ([0, 0], [0, 0], np.ones((3, 3)), "towards must have a shape"),
            (0, [0, 0], [0, 0, 0], "towards must be finite directions"),
        ):
            with pytest.raises(QueryError, match=words):
                tracer.points_on(faces, weights).offset_origins(towards=towards)
