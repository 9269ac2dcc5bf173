"""View factors against the bare rays, errors, and winding numbers: `python -m pytest bench/test_radiation.py -s`."""

import numpy as np

import clbvh
from clbvh.radiation import sky_view, tregenza_patches, view_factors

from .paired import compare, measure_ms

FACES, RAYS, POINTS = 22_000, 1024, 1_000_000


def test_view_factors_and_bare_rays():
    knot, random = clbvh.make_shape("knot", triangles=FACES), np.random.default_rng(0)
    with clbvh.Tracer(knot) as tracer:
        faces = tracer.points_on(range(knot.face_count))
        origins = np.repeat(faces.offset_origins(towards=faces.normals()), RAYS, axis=0)
        directions = np.repeat(faces.normals(), RAYS, axis=0) + (ball := random.normal(size=origins.shape))
        directions -= ball * (1 - 1 / np.linalg.norm(ball, axis=1, keepdims=True))  # the cosine around each normal
        compare(
            "view factors against closest_prim",
            lambda: measure_ms(lambda: view_factors(tracer, RAYS)),
            lambda: measure_ms(lambda: tracer.closest_prim(origins, directions)),
        )


def test_errors():
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]]
    squares, exact = clbvh.Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]), 0.1998248957
    with clbvh.Tracer(squares) as tracer:
        for rays in (1 << 10, 1 << 14, 1 << 18):
            found = [view_factors(tracer, rays, [0, 0, 1, 1], seed=seed).factor[0] for seed in range(32)]
            error = np.sqrt(np.mean((np.array(found) - exact) ** 2))
            print(
                f"parallel squares, {rays} rays: {error / np.sqrt(exact * (1 - exact) / rays):.2f} of independent rays"
            )
    # A street, as long as a street without ends, between walls at x = -1 and 1.
    walls = [[x, y, z] for x in (-1, 1) for y in (-1e4, 1e4) for z in (0, 1.5)]
    street = clbvh.Mesh.from_arrays(walls, [[0, 1, 2], [1, 2, 3], [4, 5, 6], [5, 6, 7]])
    x = np.linspace(-0.95, 0.95, 101)
    exact = ((1 + x) / np.hypot(1 + x, 1.5) + (1 - x) / np.hypot(1 - x, 1.5)) / 2
    directions, solid_angles = tregenza_patches()
    with clbvh.Tracer(street) as tracer:
        points = np.column_stack((x, 0.123 * x, 0 * x))
        for rays in (1 << 10, 1 << 14):
            print(f"sky view in a street, {rays} rays: {np.abs(sky_view(tracer, points, rays=rays) - exact).max():.5f}")
        patches = sky_view(tracer, points, directions=directions, solid_angles=solid_angles)
        print(f"sky view in a street, 145 patches: {np.abs(patches - exact).max():.5f}")


def test_winding_numbers_and_parity(mesh):
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    points = np.random.default_rng(0).uniform(lower, upper, (POINTS, 3))
    with clbvh.Tracer(mesh) as tracer:
        tracer.winding_number(points[:1])
        compare(
            "a million winding numbers against parity",
            lambda: measure_ms(lambda: tracer.winding_number(points)),
            lambda: measure_ms(lambda: tracer.contains(points)),
        )
