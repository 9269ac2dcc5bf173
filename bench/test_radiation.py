"""View factors against the bare rays, and winding numbers: `python -m pytest bench/test_radiation.py -s`."""

import numpy as np

import clbvh
from clbvh.radiation import view_factors

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
