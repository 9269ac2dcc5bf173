"""The surface of an instance at a crossing against float64, and rays that leave it."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.structs import INSTANCE, LAYOUTS, TRIANGLE

from .test_surface import make_corners, make_weights

FLOAT3 = (np.float32, (3,))
DEFINES = {"LAYOUT": LAYOUTS["brute"], "LONE": 0, "HAS_SPHERES": 0, "TOP_STACK_SIZE": 4, "STACK_SIZE": 16}
ROUNDING = 2.0**-24

# Roundings that move a point above its triangle, relative to what the entries of both matrices may add up to: twice
# those of the position and of the round trip.
ROUNDINGS = 2 * (7 + 10) + 2


def make_matrices(generator, count, kind, size):
    """(n, 3, 3) float64: from local coordinates to the scene's."""
    turns = np.linalg.qr(generator.normal(size=(count, 3, 3)))[0]
    scales = np.full((count, 3), size)
    if kind == "stretched":
        scales *= 10 ** generator.uniform(-2, 0, (count, 3))
    matrices = turns * scales[:, None, :]
    if kind == "sheared":
        shears = np.tile(np.eye(3), (count, 1, 1))
        shears[:, 0, 1] = generator.uniform(-20, 20, count)
        matrices = matrices @ shears
    # Half of them are mirrors.
    matrices[::2, :, 0] *= -1
    return matrices


@pytest.fixture(scope="module", params=["turned", "stretched", "sheared"])
def kind(request):
    return request.param


@pytest.fixture(scope="module", params=[1.0, 1e-4, 1e-9])
def placed(request, kind, run_shell):
    """Instances, triangles, rays and the arrays of `place_surfaces.cl`, by name."""
    generator = np.random.default_rng(91)
    corners, weights = make_corners(generator, 0.5, 0.0), make_weights(generator)
    count = len(corners)
    matrices, centres = make_matrices(generator, count, kind, request.param), generator.uniform(-1, 1, (count, 3))
    inverses = np.linalg.inv(matrices)
    instances = np.zeros(count, INSTANCE)
    instances["to_world"], instances["to_object"] = matrices, inverses
    instances["centre"] = centres
    instances["centre_low"] = centres - instances["centre"]
    instances["radius"] = 2 * np.abs(matrices).sum(axis=2).max(axis=1)
    triangles = np.zeros(count, TRIANGLE)
    for index, name in enumerate("abc"):
        triangles[name] = corners[:, index]

    wide = corners.astype(np.float64)
    local_normals = np.cross(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0])
    normals = np.einsum("nij,ni->nj", inverses, local_normals)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # No ray meets a triangle almost edge-on, where rounding decides the side.
    directions = generator.normal(size=(count, 3))
    directions += 0.1 * normals * np.sign((directions * normals).sum(axis=1, keepdims=True))
    normals *= -np.sign((normals * directions).sum(axis=1, keepdims=True))
    leaving = generator.normal(size=(count, 3))
    height = (leaving * normals).sum(axis=1, keepdims=True)
    target = np.where(np.arange(count)[:, None] % 2, np.abs(height), 1e-3)
    leaving = leaving + (target - height) * normals
    leaving /= np.linalg.norm(leaving, axis=1, keepdims=True)

    inputs = [instances, triangles, weights, directions.astype(np.float32), leaving.astype(np.float32)]
    found = run_shell("place_surfaces", inputs, [FLOAT3, FLOAT3, FLOAT3, np.int32], "place_surfaces", DEFINES)
    points = found[0].astype(np.float64) + found[1] - instances["centre"] - instances["centre_low"].astype(np.float64)
    return {
        "matrices": matrices, "inverses": inverses, "corners": wide, "weights": weights.astype(np.float64),
        "points": points, "normals": found[2], "is_hit": found[3], "expected_normals": normals,
        "centres": centres,
    }  # fmt: skip


def allowed_height(placed):
    """(n,) float64: the most that rounding asks for, in local units along the normal."""
    matrices, inverses = np.abs(placed["matrices"]), np.abs(placed["inverses"])
    farthest = np.abs(placed["corners"]).max(axis=1)
    reach = np.einsum("nij,nj->ni", matrices, farthest)
    error = ROUNDINGS * ROUNDING * reach + 2 * 8 * ROUNDING**2 * (reach + np.abs(placed["centres"]))
    return 1.5 * np.linalg.norm(np.einsum("nij,nj->ni", inverses, error), axis=1)


def test_the_point_is_above_the_triangle_but_not_far(placed):
    u, v = placed["weights"].T[..., None]
    a, b, c = placed["corners"].transpose(1, 0, 2)
    local = np.einsum("nij,nj->ni", placed["inverses"], placed["points"])
    normals = np.einsum("nij,ni->nj", placed["matrices"], placed["expected_normals"])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    height = ((local - a) * normals).sum(axis=1)
    allowed = allowed_height(placed)
    assert (height > 0).all()
    assert (height < allowed).all()
    aside = np.linalg.norm(local - ((1 - u - v) * a + u * b + v * c) - height[:, None] * normals, axis=1)
    assert (aside < allowed).all()


def test_a_ray_from_there_does_not_meet_the_triangle(placed):
    assert not placed["is_hit"].any()


def test_the_normal_is_a_unit_vector_across_the_placed_triangle(placed):
    normals = placed["normals"].astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=0, atol=4e-7)
    difference = np.linalg.norm(normals - placed["expected_normals"], axis=1)
    assert np.quantile(difference, 0.99) < 1e-4
    assert ((normals * placed["expected_normals"]).sum(axis=1) > 0.9).all()
