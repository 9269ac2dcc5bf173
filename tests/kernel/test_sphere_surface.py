"""The surface of a sphere where a ray enters or leaves it, against float64, and rays that leave it."""

import numpy as np
import pytest

from clbvh.structs import LAYOUTS, SPHERE

from ..rays import as_float32

COUNT = 40_000
FLOAT3 = (np.float32, (3,))
ROUNDING = 2.0**-24


@pytest.fixture(scope="module", params=[1.0, 1e-4], ids=["large", "small"])
def surfaces(request, run_shell, make_rays):
    """Spheres of about that radius, rays at them from outside and from inside, and what `shade_spheres.cl` writes."""
    generator = np.random.default_rng(93)
    radii = (request.param * generator.uniform(0.2, 1, COUNT)).astype(np.float32)
    centres = as_float32(generator.uniform(-1, 1, (COUNT, 3)))
    away = generator.normal(size=(COUNT, 3))
    outer = centres + 1.1 * away / np.linalg.norm(away, axis=1, keepdims=True) + away
    inner = centres + radii[:, None] * generator.uniform(-0.5, 0.5, (COUNT, 3))
    origins = as_float32(np.where(np.arange(COUNT)[:, None] % 4, outer, inner))
    targets = centres + 0.9 * radii[:, None] * generator.uniform(-0.57, 0.57, (COUNT, 3))
    directions = as_float32(targets - origins)

    # The normal of the nearest crossing.
    middle = ((centres - origins) * directions).sum(axis=1) / (directions**2).sum(axis=1)
    feet = origins + middle[:, None] * directions - centres
    half = np.sqrt((radii.astype(np.float64) ** 2 - (feet**2).sum(axis=1)) / (directions**2).sum(axis=1))
    is_outside = (np.arange(COUNT) % 4) != 0
    outward = (feet + np.where(is_outside, -half, half)[:, None] * directions) / radii[:, None]
    normals = np.where(is_outside[:, None], outward, -outward)

    # Away from the sphere: all directions above the surface, half of them almost along it.
    leaving = generator.normal(size=(COUNT, 3))
    height = (leaving * normals).sum(axis=1, keepdims=True)
    target = np.where(np.arange(COUNT)[:, None] % 2, np.abs(height), 1e-4)
    leaving = leaving + (target - height) * normals
    leaving = as_float32(leaving / np.linalg.norm(leaving, axis=1, keepdims=True))

    spheres = np.zeros(COUNT, SPHERE)
    spheres["centre"], spheres["radius"] = centres, radii
    names = ("position", "normal", "error", "above", "side", "is_hit")
    outputs = [FLOAT3, FLOAT3, FLOAT3, FLOAT3, np.int32, np.int32]
    found = run_shell(
        "shade_spheres", [make_rays(origins, directions), spheres, leaving.astype(np.float32)], outputs,
        "sphere_shells", {"LAYOUT": LAYOUTS["brute"], "STACK_SIZE": 1, "HAS_SPHERES": 1},
    )  # fmt: skip
    return dict(
        zip(names, found, strict=True), centres=centres, radii=radii.astype(np.float64), normals=normals,
        is_outside=is_outside,
    )  # fmt: skip


def distance_of(surfaces, name):
    """The distance of points from the sphere's surface in float64, above 0 outside."""
    return np.linalg.norm(surfaces[name].astype(np.float64) - surfaces["centres"], axis=1) - surfaces["radii"]


def test_rays_enter_from_outside_and_leave_from_inside(surfaces):
    np.testing.assert_array_equal(surfaces["side"] == 0, surfaces["is_outside"])
    assert (surfaces["side"] >= 0).all()


def test_the_normal_is_a_unit_vector_on_the_side_of_the_ray(surfaces):
    normals = surfaces["normal"].astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=0, atol=4e-7)
    # The ray is known to a rounding of its distance.
    error = 1e-5 / surfaces["radii"] * np.where(surfaces["is_outside"], 1, 0.1)
    assert (np.linalg.norm(normals - surfaces["normals"], axis=1) <= error).all()


def test_the_position_is_on_the_sphere_within_its_error(surfaces):
    # A component of the error for each axis; the distance is along the normal.
    bound = (np.abs(surfaces["normal"]) * surfaces["error"]).sum(axis=1)
    assert (np.abs(distance_of(surfaces, "position")) <= bound).all()


def test_the_point_above_is_off_the_sphere_on_the_side_of_the_ray(surfaces):
    height = np.where(surfaces["is_outside"], 1, -1) * distance_of(surfaces, "above")
    assert (height > 0).all()
    size = np.abs(surfaces["centres"]).max(axis=1) + surfaces["radii"]
    assert (height <= 4 * 2 * 16 * ROUNDING * size).all()


def test_a_ray_from_there_does_not_meet_the_sphere_from_outside(surfaces):
    assert not surfaces["is_hit"][surfaces["is_outside"]].any()
    # From inside, every ray leaves.
    assert surfaces["is_hit"][~surfaces["is_outside"]].all()
