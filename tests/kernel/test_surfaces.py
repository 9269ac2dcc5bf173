"""Surfaces of triangles, instances and spheres where rays meet them, in float64, and rays that leave them."""

import numpy as np
import pytest

from clbvh.kinds import SPHERE, SPHERES
from clbvh.structs import INSTANCE

from ..rays import as_float32
from .programs import make_rays, make_triangles

pytestmark = pytest.mark.on_both

COUNT = 20_000
ROUNDING = 2.0**-24

# Triangles with smaller angles have no precise normal in float32.
SMALLEST_SINE = 0.05


def make_corners(generator, scale, away):
    """(n, 3, 3) float32: triangles of any shape but slivers."""
    corners = (scale * (away + generator.uniform(-1, 1, (2 * COUNT, 3, 3)))).astype(np.float32)
    edges = np.diff(corners[:, [0, 1, 2, 0]].astype(np.float64), axis=1)
    edges /= np.linalg.norm(edges, axis=2, keepdims=True)
    sines = np.linalg.norm(np.cross(edges, np.roll(edges, 1, axis=1)), axis=2)
    return corners[sines.min(axis=1) > SMALLEST_SINE][:COUNT]


def make_weights(generator):
    """(n, 2) float32: u and v inside the triangle, on its edges and at its corners."""
    weights = generator.dirichlet([1, 1, 1], COUNT)
    weights[:1000] = np.eye(3)[generator.integers(0, 3, 1000)]
    weights[1000:3000, 0] = 0
    weights[1000:3000] /= weights[1000:3000].sum(axis=1, keepdims=True)
    return weights[:, 1:].astype(np.float32)


def leave(generator, normals, grazing):
    """Directions away from surfaces, half of them almost along these."""
    leaving = generator.normal(size=normals.shape)
    height = dot(leaving, normals)[:, None]
    target = np.where(np.arange(len(normals))[:, None] % 2, np.abs(height), grazing)
    return leaving + (target - height) * normals


def dot(a, b):
    return (a * b).sum(axis=1)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def interpolate(corners, weights):
    u, v = weights.astype(np.float64).T[..., None]
    return (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]


def check_unit(normals):
    np.testing.assert_allclose(np.linalg.norm(normals.astype(np.float64), axis=1), 1, rtol=0, atol=4e-7)


CROSSING = """
    crossing_t crossing = no_crossing();
    crossing.u = uv.x;
    crossing.v = uv.y;
    const corners_t corners = corners_at(triangle, 0);
"""


@pytest.mark.parametrize("place", [(1, 0), (1, 100), (1e-12, 1), (1e12, 1)], ids=str)
def test_the_surface_of_a_triangle(call, place):
    generator = np.random.default_rng(74)
    corners, weights = make_corners(generator, *place), make_weights(generator)
    wide, directions = corners.astype(np.float64), generator.normal(size=(COUNT, 3)).astype(np.float32)
    normals = unit(np.cross(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0]))
    normals *= -np.sign(dot(normals, directions))[:, None]
    leaving = leave(generator, normals, 1e-4).astype(np.float32)
    body = f"""{CROSSING}
        const surface_t surface = surface_at(&corners, &corners, &crossing, direction);
        position = surface.position; normal = surface.normal; error = surface.error; above = point_above(&surface);
        const ray_t ray = make_ray(above, leaving, 0.0f, INFINITY);
        search_t search = make_search(1, 0);
        intersect_triangle(triangle, 0, &ray, &search, QUERY_COUNT);
        is_hit = search.count;
    """
    rows = {"triangle": make_triangles(corners), "uv": weights, "direction": directions, "leaving": leaving}
    outputs = "float3 position, float3 normal, float3 error, float3 above, int is_hit"
    found = call("shading/surface.cl triangles/single.cl", body, outputs, **rows)
    position, normal, bound, above, is_hit = found
    # A ray from the point above does not meet the triangle.
    assert not is_hit.any()
    error = np.abs(position - interpolate(wide, weights))
    # The bound leaves out the rounding of the weight 1 - u - v, which counts where that is far below 1.
    assert (error <= bound + ROUNDING * np.abs(wide[:, 0])).all()
    assert (error > bound).mean() < 0.01
    # The bound is not much larger than the farthest corner's rounding.
    farthest = np.abs(wide).max(axis=(1, 2))
    assert (bound.max(axis=1) <= 8 * ROUNDING * farthest).all()
    # The normal is a unit vector on the side of the ray. Edges are rounded relative to the coordinates; normals lose as
    # much again by the smallest angle.
    check_unit(normal)
    assert (dot(normal.astype(np.float64), directions) <= 0).all()
    edges = np.linalg.norm(np.diff(wide[:, [0, 1, 2, 0]], axis=1), axis=2)
    allowed = 1e-6 * (farthest / edges.min(axis=1)) / SMALLEST_SINE
    is_seen_edge_on = np.abs(dot(normals, directions)) < 1e-5
    assert is_seen_edge_on.mean() < 0.01
    assert (np.linalg.norm(normal - normals, axis=1) <= allowed)[~is_seen_edge_on].all()
    # The point above is off the plane, and no farther than rounding asks for.
    height = dot(above.astype(np.float64) - wide[:, 0], normals)
    assert (height > 0).all()
    assert (height <= 4 * 2 * 8 * ROUNDING * farthest).all()


# Roundings that move a point above the triangle of an instance, relative to what the entries of both matrices may add
# up to: twice those of the position and of the round trip.
ROUNDINGS = 2 * (7 + 10) + 2


def make_matrices(generator, kind, size):
    """(n, 3, 3) float64: from local coordinates to the scene's; half of them are mirrors."""
    turns = np.linalg.qr(generator.normal(size=(COUNT, 3, 3)))[0]
    scales = size * (10 ** generator.uniform(-2, 0, (COUNT, 3)) if kind == "stretched" else np.ones((COUNT, 3)))
    shears = np.tile(np.eye(3), (COUNT, 1, 1))
    shears[:, 0, 1] = generator.uniform(-20, 20, COUNT) if kind == "sheared" else 0
    matrices = turns * scales[:, None, :] @ shears
    matrices[::2, :, 0] *= -1
    return matrices


@pytest.mark.parametrize("size", [1.0, 1e-4, 1e-9])
@pytest.mark.parametrize("kind", ["turned", "stretched", "sheared"])
def test_the_surface_of_an_instance(call, kind, size):
    generator = np.random.default_rng(91)
    corners, weights = make_corners(generator, 0.5, 0.0), make_weights(generator)
    matrices, centres = make_matrices(generator, kind, size), generator.uniform(-1, 1, (COUNT, 3))
    inverses, wide = np.linalg.inv(matrices), corners.astype(np.float64)
    instances = np.zeros(COUNT, INSTANCE)
    instances["to_world"], instances["to_object"], instances["centre"] = matrices, inverses, centres
    instances["centre_low"] = centres - instances["centre"]
    instances["radius"] = 2 * np.abs(matrices).sum(axis=2).max(axis=1)
    local_normals = np.cross(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0])
    normals = unit(np.einsum("nij,ni->nj", inverses, local_normals))
    # No ray meets a triangle almost edge-on, where rounding decides the side.
    directions = generator.normal(size=(COUNT, 3))
    directions += 0.1 * normals * np.sign(dot(directions, normals))[:, None]
    normals *= -np.sign(dot(normals, directions))[:, None]
    body = f"""{CROSSING}
        const float3 inwards = transform_vector(instance->to_object, direction);
        const surface_t surface = surface_at(&corners, &corners, &crossing, inwards);
        const instance_surface_t placed = place_surface(instance, &surface);
        above = placed.above; above_low = placed.above_low; normal = placed.normal;
        const ray_pair_t ray = {{above, leaving, 0.0f, INFINITY, above_low, (float3)(0.0f), 1}};
        float t_shift;
        const ray_t inside = enter_instance(&ray, instance, INFINITY, &t_shift);
        search_t search = make_search(1, 0);
        intersect_triangle(triangle, 0, &inside, &search, QUERY_COUNT);
        is_hit = search.count;
    """
    rows = {"instance": instances, "triangle": make_triangles(corners), "uv": weights, "direction": directions}
    above, above_low, normal, is_hit = call(
        "instances/surface.cl triangles/single.cl", body, "float3 above, float3 above_low, float3 normal, int is_hit",
        **rows, leaving=unit(leave(generator, normals, 1e-3)), defines={"LONE": 0, "TOP_STACK_SIZE": 4},
    )  # fmt: skip
    assert not is_hit.any()
    check_unit(normal)
    assert np.quantile(np.linalg.norm(normal - normals, axis=1), 0.99) < 1e-4
    assert (dot(normal, normals) > 0.9).all()
    # The point is above the triangle, but no farther than rounding asks for, in local units along the normal.
    points = above.astype(np.float64) + above_low - instances["centre"] - instances["centre_low"].astype(np.float64)
    local = np.einsum("nij,nj->ni", inverses, points)
    inner_normals = unit(np.einsum("nij,ni->nj", matrices, normals))
    reach = np.einsum("nij,nj->ni", np.abs(matrices), np.abs(wide).max(axis=1))
    error = ROUNDINGS * ROUNDING * reach + 2 * 8 * ROUNDING**2 * (reach + np.abs(centres))
    allowed = 1.5 * np.linalg.norm(np.einsum("nij,nj->ni", np.abs(inverses), error), axis=1)
    height = dot(local - wide[:, 0], inner_normals)
    assert ((height > 0) & (height < allowed)).all()
    aside = np.linalg.norm(local - interpolate(wide, weights) - height[:, None] * inner_normals, axis=1)
    assert (aside < allowed).all()


@pytest.mark.parametrize("size", [1.0, 1e-4], ids=["large", "small"])
def test_the_surface_of_a_sphere(call, size):
    generator = np.random.default_rng(93)
    spheres = np.zeros(COUNT, SPHERE)
    spheres["radius"] = size * generator.uniform(0.2, 1, COUNT)
    spheres["centre"] = generator.uniform(-1, 1, (COUNT, 3))
    radii, centres = spheres["radius"].astype(np.float64), spheres["centre"].astype(np.float64)
    away = generator.normal(size=(COUNT, 3))
    is_outside = np.arange(COUNT) % 4 != 0
    inner = centres + radii[:, None] * generator.uniform(-0.5, 0.5, (COUNT, 3))
    origins = as_float32(np.where(is_outside[:, None], centres + 1.1 * unit(away) + away, inner))
    directions = as_float32(centres + 0.9 * radii[:, None] * generator.uniform(-0.57, 0.57, (COUNT, 3)) - origins)
    # The normal of the nearest crossing.
    middle = dot(centres - origins, directions) / dot(directions, directions)
    feet = origins + middle[:, None] * directions - centres
    half = np.sqrt((radii**2 - dot(feet, feet)) / dot(directions, directions))
    outward = (feet + np.where(is_outside, -half, half)[:, None] * directions) / radii[:, None]
    normals = np.where(is_outside[:, None], outward, -outward)
    body = """
        const ray_t unpacked = unpack_ray(ray);
        search_t search = make_search(1, 0);
        intersect_sphere(sphere, 0, &unpacked, &search, QUERY_CLOSEST);
        side = is_found(&search.nearest) ? (int)search.nearest.u : -1;
        const ball_t ball = ball_at(sphere, 0);
        const surface_t surface = sphere_surface_at(&ball, search.nearest.u > 0.0f, &unpacked);
        position = surface.position; normal = surface.normal; error = surface.error; above = point_above(&surface);
        const ray_t from_above = make_ray(above, leaving, 0.0f, INFINITY);
        search_t blockers = make_search(1, 0);
        intersect_sphere(sphere, 0, &from_above, &blockers, QUERY_COUNT);
        is_hit = blockers.count;
    """
    outputs = "float3 position, float3 normal, float3 error, float3 above, int side, int is_hit"
    position, normal, error, above, side, is_hit = call(
        "spheres/single.cl spheres/surface.cl", body, outputs, ray=make_rays(origins, directions), sphere=spheres,
        leaving=unit(leave(generator, normals, 1e-4)), defines={"KINDS": SPHERES.bit},
    )  # fmt: skip

    def height_of(points):
        return np.linalg.norm(points.astype(np.float64) - centres, axis=1) - radii

    # Rays enter from outside and leave from inside; from there, only those inside meet the sphere again.
    np.testing.assert_array_equal(side, np.where(is_outside, 0, 1))
    np.testing.assert_array_equal(is_hit, np.where(is_outside, 0, 1))
    check_unit(normal)
    # The ray is known to a rounding of its distance.
    assert (np.linalg.norm(normal - normals, axis=1) <= 1e-5 / radii * np.where(is_outside, 1, 0.1)).all()
    # A component of the error for each axis; the distance is along the normal.
    assert (np.abs(height_of(position)) <= dot(np.abs(normal), error)).all()
    height = np.where(is_outside, 1, -1) * height_of(above)
    assert (height > 0).all()
    assert (height <= 4 * 2 * 16 * ROUNDING * (np.abs(centres).max(axis=1) + radii)).all()
