"""The surface at a crossing against float64, and rays that leave it."""

import numpy as np
import pytest

from clbvh.structs import TRIANGLE

FLOAT3 = (np.float32, (3,))
COUNT = 20_000

ROUNDING = 2.0**-24

# Triangles with smaller angles have no precise normal in float32.
SMALLEST_SINE = 0.05


def make_corners(generator, scale, away):
    """(n, 3, 3) float32: triangles of any shape but slivers."""
    corners = scale * (away + generator.uniform(-1, 1, (2 * COUNT, 3, 3)))
    corners = corners.astype(np.float32)
    edges = np.diff(corners[:, [0, 1, 2, 0]].astype(np.float64), axis=1)
    edges /= np.linalg.norm(edges, axis=2, keepdims=True)
    sines = np.linalg.norm(np.cross(edges, np.roll(edges, 1, axis=1)), axis=2)
    kept = corners[sines.min(axis=1) > SMALLEST_SINE]
    assert len(kept) > COUNT
    return kept[:COUNT]


def make_weights(generator):
    """(n, 2) float32: u and v inside the triangle, on its edges and at its corners."""
    weights = generator.dirichlet([1, 1, 1], COUNT)
    weights[:1000] = np.eye(3)[generator.integers(0, 3, 1000)]
    weights[1000:3000, 0] = 0
    weights[1000:3000] /= weights[1000:3000].sum(axis=1, keepdims=True)
    return weights[:, 1:].astype(np.float32)


@pytest.fixture(scope="module", params=[(1.0, 0.0), (1.0, 100.0), (1e-12, 1.0), (1e12, 1.0)], ids=str)
def surfaces(request, run_shell):
    """Triangles, crossings, rays and the arrays of `find_surfaces.cl`, by name."""
    generator = np.random.default_rng(74)
    corners, weights = make_corners(generator, *request.param), make_weights(generator)
    directions = generator.normal(size=(COUNT, 3)).astype(np.float32)
    wide = corners.astype(np.float64)
    edge_a, edge_b = wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0]
    normals = np.cross(edge_a, edge_b)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals *= -np.sign((normals * directions).sum(axis=1, keepdims=True))
    # Away from the triangle, half of the rays almost in its plane.
    leaving = generator.normal(size=(COUNT, 3))
    height = (leaving * normals).sum(axis=1, keepdims=True)
    target = np.where(np.arange(COUNT)[:, None] % 2, np.abs(height), 1e-4)
    leaving = (leaving + (target - height) * normals).astype(np.float32)

    triangles = np.zeros(COUNT, TRIANGLE)
    for index, name in enumerate("abc"):
        triangles[name] = corners[:, index]
    names = ("position", "normal", "error", "above", "is_hit")
    outputs = [FLOAT3, FLOAT3, FLOAT3, FLOAT3, np.int32]
    found = run_shell("find_surfaces", [triangles, weights, directions, leaving], outputs)
    return dict(
        zip(names, found, strict=True), corners=wide, weights=weights.astype(np.float64), normals=normals,
        directions=directions, leaving=leaving,
    )  # fmt: skip


def test_the_position_is_within_its_error(surfaces):
    u, v = surfaces["weights"].T[..., None]
    a, b, c = surfaces["corners"].transpose(1, 0, 2)
    expected = (1 - u - v) * a + u * b + v * c
    error = np.abs(surfaces["position"] - expected)
    # The bound leaves out the rounding of the weight 1 - u - v, which counts where that is far below 1.
    rounded_weight = ROUNDING * np.abs(a)
    assert (error <= surfaces["error"] + rounded_weight).all()
    assert (error > surfaces["error"]).mean() < 0.01
    # The bound is not much larger than the farthest corner's rounding.
    farthest = np.abs(surfaces["corners"]).max(axis=(1, 2))
    assert (surfaces["error"].max(axis=1) <= 8 * ROUNDING * farthest).all()


def test_the_normal_is_a_unit_vector_on_the_side_of_the_ray(surfaces):
    normal = surfaces["normal"].astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, rtol=0, atol=4e-7)
    assert ((normal * surfaces["directions"]).sum(axis=1) <= 0).all()


def test_the_normal_is_perpendicular_to_the_triangle(surfaces):
    # Edges are rounded relative to the coordinates; normals lose as much again by the smallest angle.
    size = np.abs(surfaces["corners"]).max(axis=(1, 2))
    edges = np.linalg.norm(np.diff(surfaces["corners"][:, [0, 1, 2, 0]], axis=1), axis=2)
    error = 1e-6 * (size / edges.min(axis=1)) / SMALLEST_SINE
    difference = np.linalg.norm(surfaces["normal"] - surfaces["normals"], axis=1)
    is_seen_edge_on = np.abs((surfaces["normals"] * surfaces["directions"]).sum(axis=1)) < 1e-5
    assert is_seen_edge_on.mean() < 0.01
    assert (difference <= error)[~is_seen_edge_on].all()


def test_the_point_above_is_off_the_plane_on_the_side_of_the_ray(surfaces):
    above = surfaces["above"].astype(np.float64)
    height = ((above - surfaces["corners"][:, 0]) * surfaces["normals"]).sum(axis=1)
    assert (height > 0).all()
    # And no farther than rounding asks for.
    assert (height <= 4 * 2 * 8 * ROUNDING * np.abs(surfaces["corners"]).max(axis=(1, 2))).all()


def test_a_ray_from_the_point_above_does_not_meet_the_triangle(surfaces):
    assert not surfaces["is_hit"].any()
