"""The sky-view factor of the ground: the share of the sky's light that reaches each point of a map.

    python examples/sky_view.py [MESH] [-o sky-view.png] [--width 400] [--rays 64]

Without a mesh it maps mountains of 10 km by 10 km. y is up; the map has x to the right and z downwards.
"""

from __future__ import annotations

import argparse

import imageio.v3 as imageio
import numpy as np

import clbvh
import clbvh.radiation

# From closed in to open: dark blue, green, sand, white. Linear between these colours.
COLOURS = np.array([[20, 24, 60], [30, 100, 110], [150, 160, 110], [235, 215, 170], [255, 255, 255]])


def map_ground(tracer: clbvh.Tracer, mesh: clbvh.Mesh, width: int) -> clbvh.Hits:
    """Return the highest point of the mesh at each pixel of a map, (height, width): rays straight down."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    height = max(1, round(width * (high[2] - low[2]) / (high[0] - low[0])))
    # Pixel centres.
    x = low[0] + (high[0] - low[0]) * (np.arange(width) + 0.5) / width
    z = low[2] + (high[2] - low[2]) * (np.arange(height) + 0.5) / height
    above = high[1] + (high - low).max()
    origins = np.stack(np.broadcast_arrays(x[None, :], above, z[:, None]), axis=-1)
    return tracer.closest_hit(origins, [0, -1, 0])


def sky_view_factor(tracer: clbvh.Tracer, ground: clbvh.Hits, rays: int) -> np.ndarray:
    """Return the share of the sky's light that each point on the ground gets, 0 to 1; NaN where there is none."""
    up = (0, 1, 0)
    factor = np.full(ground.t.shape, np.nan)
    factor[ground.is_hit] = clbvh.radiation.sky_view(tracer, ground[ground.is_hit], normals=up, up=up, rays=rays)
    return factor


def colour(factor: np.ndarray) -> np.ndarray:
    """Return the colours of shares of sky, (..., 3) uint8: the darkest for the most closed points; grey for none."""
    least, most = np.nanquantile(factor, [0.01, 0.99])
    stops = np.linspace(least, max(most, least + 1e-9), len(COLOURS))
    bands = [np.interp(factor, stops, COLOURS[:, band]) for band in range(3)]
    return np.nan_to_num(np.stack(bands, axis=-1), nan=128).astype(np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", help="a mesh file; without it, mountains")
    parser.add_argument("-o", "--output", default="sky-view.png")
    parser.add_argument("--width", type=int, default=400, help="pixels of the map")
    parser.add_argument("--rays", type=int, default=64, help="rays to the sky from each point")
    options = parser.parse_args()
    mesh = clbvh.load_mesh(options.mesh) if options.mesh else clbvh.make_shape("terrain", triangles=200_000, seed=7)
    with clbvh.Tracer(mesh) as tracer:
        ground = map_ground(tracer, mesh, options.width)
        factor = sky_view_factor(tracer, ground, options.rays)
    imageio.imwrite(options.output, colour(factor))
    height, width = factor.shape
    print(
        f"{options.output}: {width} x {height} points see {np.nanmean(factor):.1%} of the sky, "
        f"a hundredth of them less than {np.nanquantile(factor, 0.01):.1%}"
    )


if __name__ == "__main__":
    main()
