"""The share of the sky that each face of a mesh sees: any-hit rays over the hemisphere above its middle.

    python examples/ambient_occlusion.py [MESH] [-o occlusion.ply] [--rays 64]

Writes a PLY file with the share of open sky as grey face colours.
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh

import clbvh

# Rays of each face that are cast together.
TOGETHER = 8


def open_sky(tracer: clbvh.Tracer, mesh: clbvh.Mesh, rays: int, seed: int = 0) -> np.ndarray:
    """Return the cosine-weighted share of directions without a hit, (F,), for the middle of each face."""
    third = np.full(mesh.face_count, 1 / 3)
    middles = clbvh.Hits(0 * third, third, third, np.arange(mesh.face_count, dtype=np.int32), mesh)
    normals = middles.normals
    origins = middles.offset_origins(towards=normals)
    generator = np.random.default_rng(seed)
    seen = np.zeros(mesh.face_count)
    for first in range(0, rays, TOGETHER):
        # Directions to random points on the unit sphere around the tip of the normal are cosine-weighted.
        directions = generator.normal(size=(min(TOGETHER, rays - first), mesh.face_count, 3))
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        directions += normals
        # Origins (F, 3) are broadcast against directions (rays, F, 3).
        seen += (~tracer.any_hit(origins, directions)).sum(axis=0)
    return seen / rays


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", help="a mesh file; without it, a knot")
    parser.add_argument("-o", "--output", default="occlusion.ply")
    parser.add_argument("--rays", type=int, default=64)
    options = parser.parse_args()
    mesh = clbvh.load_mesh(options.mesh) if options.mesh else clbvh.make_shape("knot", triangles=20_000)
    with clbvh.Tracer(clbvh.build(mesh)) as tracer:
        sky = open_sky(tracer, mesh, options.rays)
    grey = np.round(255 * sky).astype(np.uint8)
    colours = np.stack([grey, grey, grey, np.full_like(grey, 255)], axis=1)
    trimesh.Trimesh(mesh.vertices, mesh.faces, face_colors=colours, process=False).export(options.output)
    print(f"{options.output}: faces see {sky.mean():.0%} of the sky, from {sky.min():.0%} to {sky.max():.0%}")


if __name__ == "__main__":
    main()
