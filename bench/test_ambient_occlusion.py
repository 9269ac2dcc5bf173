"""Ambient occlusion of 100,000 points on the surface, 64 rays each, beside Open3D with rays made in numpy."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.scene.copies import DRAWS_PER_POINT, sample_surface
from clbvh.study.engines import Open3D, Queries, Rival

from .paired import compare, measure_ms

POINTS = 100_000
RAYS = 64
OFFSET_SHARE = 1e-5

# Shares of two kinds of random rays differ by this much on average, at most.
LARGEST_DIFFERENCE = 2e-3


def make_rays(points, normals, offset, generator):
    """Cosine-weighted rays as users of Open3D make them: (n, RAYS, 6) float32."""
    first, second = generator.random((2, len(points), RAYS), dtype=np.float32)
    radius, angle = np.sqrt(first), 2 * np.pi * second
    z = normals.astype(np.float32)
    sign = np.where(z[:, 2] < 0, np.float32(-1), np.float32(1))
    a = -1 / (sign + z[:, 2])
    b = z[:, 0] * z[:, 1] * a
    tangent = np.stack((1 + sign * z[:, 0] ** 2 * a, sign * b, -sign * z[:, 0]), axis=-1)
    bitangent = np.stack((b, sign + z[:, 1] ** 2 * a, -z[:, 1]), axis=-1)
    rays = np.empty((len(points), RAYS, 6), np.float32)
    rays[..., :3] = (points + offset * normals).astype(np.float32)[:, None]
    rays[..., 3:] = (radius * np.cos(angle))[..., None] * tangent[:, None]
    rays[..., 3:] += (radius * np.sin(angle))[..., None] * bitangent[:, None]
    rays[..., 3:] += np.sqrt(1 - first)[..., None] * z[:, None]
    return rays


def serve_open3d(vertices, faces, points, normals) -> Queries:
    """Return Open3D's queries: rays are made and cast, or cast alone."""
    engine = Open3D(vertices, faces)
    engine.build()
    offset = OFFSET_SHARE * np.ptp(vertices, axis=0).max()
    made = engine.pack(make_rays(points, normals, offset, np.random.default_rng(0)))

    def cast(rays):
        return 1 - engine.scene.test_occlusions(rays).numpy().mean(axis=1)

    def make_and_cast():
        return cast(engine.pack(make_rays(points, normals, offset, np.random.default_rng(1))))

    return {"cast": lambda: cast(made), "make and cast": make_and_cast}


@pytest.fixture(scope="module")
def samples(mesh):
    """Points on the surface and the normals of their faces."""
    draws = np.random.default_rng(1).random((POINTS, DRAWS_PER_POINT))
    return sample_surface(mesh.vertices, mesh.faces, draws, name=mesh.name)


def test_against_open3d(mesh, samples, open3d):
    with (
        Rival(serve_open3d, mesh.vertices, mesh.faces, *samples) as theirs,
        clbvh.Tracer(clbvh.build(mesh)) as tracer,
    ):
        ours, peers = tracer.ambient_occlusion(*samples, rays=RAYS), theirs.measure("cast").result
        print(f"\nopen: {ours.mean():.4f}, peer {peers.mean():.4f}")
        assert abs(ours.mean() - peers.mean()) < LARGEST_DIFFERENCE
        for task in ("make and cast", "cast"):
            compare(
                f"ambient occlusion, {POINTS:,} points, {RAYS} rays, Open3D: {task}",
                lambda: measure_ms(lambda: tracer.ambient_occlusion(*samples, rays=RAYS)),
                lambda task=task: theirs.measure(task).wall_ms,
            )
