"""Start points of rays that leave the instances of a scene: they never meet what they leave."""

import numpy as np
import pytest

import clbvh
from tests.unit.trace.test_offsets import MESHES, make_directions, turn

RAYS = 4000
INSTANCES = 4


def shear(generator):
    matrix = np.eye(3)
    matrix[0, 1] = 100
    return turn(generator) @ matrix @ turn(generator)


MAPS = {
    "rotation": turn,
    "mirror": lambda generator: turn(generator) @ np.diag([1, 1, -1]) @ turn(generator) * np.sign(generator.normal()),
    "stretch": lambda generator: turn(generator) @ np.diag(10 ** generator.uniform(-2, 2, 3)) @ turn(generator),
    "flattened": lambda generator: turn(generator) @ np.diag([1, 1, 10 ** generator.uniform(-12, -4)]),
    "needle": lambda generator: turn(generator) @ np.diag([1e-5, 1e-8, 1]),
    "shear": shear,
}


def make_spheres(generator):
    return clbvh.Spheres(generator.normal(size=(200, 3)), 10 ** generator.uniform(-3, -0.5, 200))


def place(shape, name, far, size, generator):
    """A scene of several instances of one shape, of this size, and this many sizes from zero."""
    scene = clbvh.Scene()
    geometry = scene.add(shape)
    for _ in range(INSTANCES):
        transform = np.eye(4)
        transform[:3, :3] = MAPS[name](generator) * size
        transform[:3, 3] = (2 * generator.normal(size=3) + far) * size
        scene.place(geometry, transform)
    return scene


def make_targets(shape, generator):
    """Points on the primitives, many of them close to edges, and inside of spheres."""
    prims = generator.integers(shape.prim_count, size=RAYS)
    if isinstance(shape, clbvh.Spheres):
        outwards = generator.normal(size=(RAYS, 3))
        outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
        return shape.centres[prims] + shape.radii[prims, None] * outwards * generator.choice(
            [1, 0.9999, 0.5], (RAYS, 1)
        )
    weights = generator.dirichlet(np.full(3, 0.4), RAYS)
    return (weights[:, :, None] * shape.vertices[shape.faces[prims]]).sum(axis=1)


def make_hits(tracer, shape, scene, size, generator):
    """Hits of rays at all instances, from near and far."""
    transforms = scene.snapshot().transforms
    transforms = transforms[generator.integers(len(transforms), size=RAYS)]
    targets = np.einsum("nij,nj->ni", transforms[:, :3, :3], make_targets(shape, generator)) + transforms[:, :3, 3]
    away = generator.normal(size=(RAYS, 3)) * size * 10.0 ** generator.uniform(-2, 1, (RAYS, 1))
    hits = tracer.closest_hit(targets + away, -away)
    return hits[hits.is_hit]


def count_own(tracer, hits, origins, directions):
    """How often each ray crosses the primitive that it leaves, at most 1 if only the closest hit says so."""
    crossings = tracer.all_hits(origins, directions)
    ray_id = crossings.ray_id
    is_own = (crossings.prim_id == hits.prim_id[ray_id]) & (crossings.instance_id == hits.instance_id[ray_id])
    closest = tracer.closest_hit(origins, directions)
    is_closest = (closest.prim_id == hits.prim_id) & (closest.instance_id == hits.instance_id)
    return np.maximum(np.bincount(ray_id[is_own], minlength=len(hits)), is_closest)


def find_hopeless(hits, origins, is_inside):
    """Which start points are in spheres too small for them: they may have moved to the centre.

    How far they have moved is known to the rounding of their world coordinates.
    """
    arrays = hits.surface.arrays
    if len(arrays.spheres) == 0:
        return np.zeros(len(hits), bool)
    inverse = arrays.inverse[hits.instance_id]
    moved = np.linalg.norm(np.einsum("nij,nj->ni", inverse, origins - hits.locations), axis=1)
    noise = np.linalg.norm(np.einsum("nij,nj->ni", np.abs(inverse), 2.0**-51 * np.abs(origins)), axis=1)
    return is_inside & (moved + noise > 0.99 * arrays.spheres[hits.prim_id, 3])


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("far", [0.0, 1e7])
@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("kind", ["soup", "slivers", "needles", "spheres"])
def test_rays_do_not_meet_the_primitive_that_they_leave(session, kind, name, far, size):
    generator = np.random.default_rng(19)
    shape = make_spheres(generator) if kind == "spheres" else clbvh.Mesh.from_arrays(*MESHES[kind](generator))
    check_rays_that_leave(session, shape, place(shape, name, far, size, generator), size, generator)


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("far", [0.0, 1e4])
@pytest.mark.parametrize("seed", [19, 20, 21])
def test_rays_do_not_meet_the_lone_sphere_that_they_leave(session, far, size, seed):
    generator = np.random.default_rng(seed)
    spheres = make_spheres(generator)
    spheres = clbvh.Spheres((spheres.centres + far) * size, spheres.radii * size)
    check_rays_that_leave(session, spheres, clbvh.Scene(spheres), size, generator)


def check_rays_that_leave(session, shape, scene, size, generator):
    has_spheres = isinstance(shape, clbvh.Spheres)
    with clbvh.Tracer(scene, device=session.info) as tracer:
        hits = make_hits(tracer, shape, scene, size, generator)
        assert len(hits) > 20
        directions = make_directions(hits.normals(facing=True), generator)
        origins = hits.offset_origins()
        count = count_own(tracer, hits, origins, directions)
        # From inside of a sphere, every ray leaves it once.
        inside = ~hits.is_front & has_spheres
        is_known = ~find_hopeless(hits, origins, inside)
        np.testing.assert_array_equal(count[is_known], inside[is_known])

        # Through the surface, on the side to which a direction leads.
        towards = generator.normal(size=(len(hits), 3)) * size
        leads_inside = (hits.normals * towards).sum(axis=1) < 0
        origins = hits.offset_origins(towards=towards)
        count = count_own(tracer, hits, origins, towards)
        inside = leads_inside & has_spheres
        is_known = ~find_hopeless(hits, origins, inside)
        np.testing.assert_array_equal(count[is_known], inside[is_known])


@pytest.mark.parametrize("kind", ["soup", "spheres"])
def test_the_rays_are_hard_ones(session, kind):
    generator = np.random.default_rng(19)
    shape = make_spheres(generator) if kind == "spheres" else clbvh.Mesh.from_arrays(*MESHES[kind](generator))
    scene = place(shape, "rotation", 0.0, 1.0, generator)
    with clbvh.Tracer(scene, device=session.info) as tracer:
        hits = make_hits(tracer, shape, scene, 1.0, generator)
        hits = hits[hits.is_front]
        directions = make_directions(hits.normals, generator)
        assert (count_own(tracer, hits, hits.locations, directions) > 0).mean() > 0.1


@pytest.mark.parametrize("kind", ["knot", "spheres"])
@pytest.mark.parametrize("name", ["rotation", "mirror", "flattened"])
def test_start_points_stay_close(session, name, kind):
    generator = np.random.default_rng(23)
    shape = make_spheres(generator) if kind == "spheres" else clbvh.Mesh.from_arrays(*MESHES[kind](generator))
    scene = place(shape, name, 0.0, 1.0, generator)
    with clbvh.Tracer(scene, device=session.info) as tracer:
        hits = make_hits(tracer, shape, scene, 1.0, generator)
    largest = 2 * np.abs(shape.local_box).max() / shape.scale
    distances = np.linalg.norm(hits.offset_origins() - hits.locations, axis=1)
    assert (distances > 0).all()
    assert distances.max() < 3e-5 * largest


def test_start_points_of_a_far_scene_need_no_more_than_its_rounding(session):
    generator = np.random.default_rng(29)
    shape = clbvh.Mesh.from_arrays(*MESHES["knot"](generator))
    scene = place(shape, "rotation", 1e7, 1.0, generator)
    with clbvh.Tracer(scene, device=session.info) as tracer:
        hits = make_hits(tracer, shape, scene, 1.0, generator)
    assert np.linalg.norm(hits.offset_origins() - hits.locations, axis=1).max() < 1e-3
