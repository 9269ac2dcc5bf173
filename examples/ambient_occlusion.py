"""Ambient occlusion baked into a mesh: the share of open sky at each vertex, as its colour.

    python examples/ambient_occlusion.py [MESH] [-o occlusion.ply] [--rays 256] [--distance SHARE]

Writes a PLY file with grey vertex colours, which any viewer shows without lights of its own.
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh

import clbvh


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", help="a mesh file; without it, a knot")
    parser.add_argument("-o", "--output", default="occlusion.ply")
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--distance", type=float, default=np.inf, help="how far occluders may be, in sizes of the mesh")
    options = parser.parse_args()
    mesh = clbvh.load_mesh(options.mesh) if options.mesh else clbvh.make_shape("knot", triangles=20_000)
    reach = options.distance * np.ptp(mesh.vertices, axis=0).max()
    with clbvh.Tracer(mesh) as tracer:
        sky = tracer.ambient_occlusion(mesh.vertices, mesh.vertex_normals, rays=options.rays, max_distance=reach)
    grey = np.round(255 * sky).astype(np.uint8)
    colours = np.stack([grey, grey, grey, np.full_like(grey, 255)], axis=1)
    trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colours, process=False).export(options.output)
    print(f"{options.output}: vertices see {sky.mean():.0%} of the sky, from {sky.min():.0%} to {sky.max():.0%}")


if __name__ == "__main__":
    main()
