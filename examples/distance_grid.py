"""Inside and signed distance on a grid: the volume of a part, and a section through its distance field.

    python examples/distance_grid.py [MESH] [-o distance-grid.png] [--grid grid.npz] [--cells 64]

Without a mesh it takes a knotted tube. The mesh must be closed. Distances are positive inside.
"""

from __future__ import annotations

import argparse

import imageio.v3 as imageio
import numpy as np

import clbvh

INSIDE, OUTSIDE = np.array([214, 104, 52]), np.array([62, 104, 150])
SECTION_WIDTH = 480  # pixels
LINES = 12  # contour lines between the surface and the farthest point of the section


def grid_points(mesh: clbvh.Mesh, cells: int) -> tuple[np.ndarray, float]:
    """Return the centres of cubic cells around a mesh, (nx, ny, nz, 3), and the side of a cell."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    side = float((high - low).max()) / cells
    counts = np.ceil((high - low) / side).astype(int) + 2
    centre = (low + high) / 2
    axes = [centre[axis] + side * (np.arange(counts[axis]) - (counts[axis] - 1) / 2) for axis in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), side


def section_points(mesh: clbvh.Mesh) -> tuple[np.ndarray, float]:
    """Return pixel centres of a section across the z axis, (height, width, 3), and the side of a pixel."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    pixel = 1.2 * (high[0] - low[0]) / SECTION_WIDTH
    height = max(1, round(1.2 * (high[1] - low[1]) / pixel))
    centre = (low + high) / 2
    x = centre[0] + pixel * (np.arange(SECTION_WIDTH) - (SECTION_WIDTH - 1) / 2)
    y = centre[1] - pixel * (np.arange(height) - (height - 1) / 2)
    return np.stack(np.broadcast_arrays(x[None, :], y[:, None], centre[2]), axis=-1), pixel


def draw(distance: np.ndarray, pixel: float) -> np.ndarray:
    """Return a picture of distances, (height, width, 3) uint8: contour lines, and a black one for the surface."""
    farthest = np.abs(distance).max()
    step = farthest / LINES
    shade = (1 - 0.75 * np.abs(distance) / farthest)[..., None]
    picture = 255 - shade * (255 - np.where(distance[..., None] > 0, INSIDE, OUTSIDE))
    from_line = np.abs((distance + step / 2) % step - step / 2)
    picture[from_line < 0.5 * pixel] *= 0.75
    picture[np.abs(distance) < 1.2 * pixel] = 0
    return picture.astype(np.uint8)


def volume(mesh: clbvh.Mesh) -> float:
    """Return the volume by the divergence theorem, for faces that all point outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", help="the file of a closed mesh; without it, a knot")
    parser.add_argument("-o", "--output", default="distance-grid.png")
    parser.add_argument("--grid", help="also write points and distances, as an NPZ file")
    parser.add_argument("--cells", type=int, default=64, help="cells along the longest side")
    options = parser.parse_args()
    mesh = clbvh.load_mesh(options.mesh) if options.mesh else clbvh.make_shape("knot", triangles=20_000)

    points, side = grid_points(mesh, options.cells)
    section, pixel = section_points(mesh)
    with clbvh.Tracer(mesh) as tracer:
        inside = tracer.contains(points)  # points of any shape; so is the answer
        distance = tracer.signed_distance(section)
        if options.grid:
            np.savez(options.grid, points=points, distance=tracer.signed_distance(points))
    imageio.imwrite(options.output, draw(distance, pixel))
    shape = " x ".join(map(str, inside.shape))
    print(f"{options.output}: {shape} cells of {side:.4g}, {inside.mean():.1%} of them inside")
    print(f"volume by cells: {inside.sum() * side**3:.6g}, by faces: {volume(mesh):.6g}; deepest: {distance.max():.4g}")


if __name__ == "__main__":
    main()
