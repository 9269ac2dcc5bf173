"""The share of the sky that each vertex of a mesh sees: any-hit rays over the hemisphere above it.

    python examples/ambient_occlusion.py [MESH] [-o occlusion.ply] [--rays 64]

Writes a PLY file with the share of open sky as grey vertex colours.
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh

import clbvh


def vertex_normals(mesh: clbvh.Mesh) -> np.ndarray:
    """Return (V, 3) unit normals: the mean of the faces around each vertex, weighted by area."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    normals = np.zeros((len(mesh.vertices), 3))
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], np.cross(b - a, c - a))
    return normals / np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]


def open_sky(tracer: clbvh.Tracer, mesh: clbvh.Mesh, rays: int, seed: int = 0) -> np.ndarray:
    """Return the cosine-weighted share of directions without a hit, (V,), for each vertex."""
    normals = vertex_normals(mesh)
    size = float(np.ptp(mesh.vertices, axis=0).max())
    origins = mesh.vertices + 1e-4 * size * normals
    generator = np.random.default_rng(seed)
    seen = np.zeros(len(origins))
    for _ in range(rays):
        # Directions to random points on the unit sphere around the tip of the normal are cosine-weighted.
        offset = generator.normal(size=origins.shape)
        offset /= np.linalg.norm(offset, axis=1)[:, None]
        seen += ~tracer.any_hit(origins, normals + 0.999 * offset)
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
    trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colours, process=False).export(options.output)
    print(f"{options.output}: vertices see {sky.mean():.0%} of the sky, from {sky.min():.0%} to {sky.max():.0%}")


if __name__ == "__main__":
    main()
