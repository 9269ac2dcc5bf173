"""A depth map of a trimesh, with rays cast by `mesh.ray`, which is clbvh's.

    python examples/depth_map.py [MESH] [-o depth.png] [--width 640]

Near is white; far is dark, and the background is black.
"""

from __future__ import annotations

import argparse

import imageio.v3 as imageio
import numpy as np
import trimesh

import clbvh
from clbvh.integrations.trimesh import RayMeshIntersector


def depth_map(mesh: trimesh.Trimesh, width: int, height: int) -> np.ndarray:
    """Return distances along the view, (height, width), NaN without a hit; the camera looks down the z axis."""
    low, high = mesh.bounds
    x = np.linspace(low[0], high[0], width)
    y = np.linspace(high[1], low[1], height)
    distance = 2 * (high[2] - low[2]) or 1.0
    origins = np.stack([*np.meshgrid(x, y), np.full((height, width), high[2] + distance)], axis=-1).reshape(-1, 3)
    directions = np.tile([0.0, 0.0, -1.0], (len(origins), 1))
    locations, index_ray, _ = mesh.ray.intersects_location(origins, directions, multiple_hits=False)
    depth = np.full(len(origins), np.nan)
    depth[index_ray] = origins[index_ray, 2] - locations[:, 2]
    return depth.reshape(height, width)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", help="a mesh file; without it, a knot")
    parser.add_argument("-o", "--output", default="depth.png")
    parser.add_argument("--width", type=int, default=640)
    options = parser.parse_args()
    shape = clbvh.load_mesh(options.mesh) if options.mesh else clbvh.make_shape("knot", triangles=20_000)
    mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    mesh.ray = RayMeshIntersector(mesh)
    extents = mesh.extents
    height = max(1, round(options.width * extents[1] / extents[0]))
    depth = depth_map(mesh, options.width, height)
    near, far = np.nanmin(depth), np.nanmax(depth)
    grey = np.nan_to_num(255 * (1 - 0.9 * (depth - near) / max(far - near, np.finfo(float).tiny)))
    imageio.imwrite(options.output, np.round(grey).astype(np.uint8))
    print(f"{options.output}: {options.width} x {height}, depths from {near:.6g} to {far:.6g}, by {mesh.ray!r}")


if __name__ == "__main__":
    main()
