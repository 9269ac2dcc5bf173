"""A lidar that rotates under a drone: one ray per laser pulse, and the point cloud coloured by range.

    python examples/lidar_scan.py [MESH] [-o lidar-scan.png] [--cloud points.ply] [--steps 720] [--beams 64]

Without a mesh it flies over mountains of 10 km by 10 km. y is up.
"""

from __future__ import annotations

import argparse

import imageio.v3 as imageio
import numpy as np
import trimesh

import clbvh

REVOLUTIONS = 12
LOWEST, HIGHEST = -70.0, 5.0  # degrees of the beams above the horizon
NOISE = 0.002  # standard deviation of a range, in units of the mesh

# Near to far: yellow, orange, violet, blue. Linear between these colours.
COLOURS = np.array([[255, 236, 153], [250, 145, 60], [200, 60, 110], [105, 45, 150], [35, 50, 120]])


def fly(mesh: clbvh.Mesh, steps: int) -> np.ndarray:
    """Return the scanner's positions, (steps, 3): along x, through the middle, above everything there."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    along = np.linspace(low[0] + 0.3 * (high[0] - low[0]), low[0] + 0.7 * (high[0] - low[0]), steps)
    return np.stack([along, np.full(steps, high[1]), np.full(steps, mesh.origin[2])], axis=-1)


def aim(steps: int, beams: int) -> np.ndarray:
    """Return the directions of all pulses, (steps, beams, 3), of length 1: a fan of beams that turns around y."""
    azimuth = np.linspace(0, 2 * np.pi * REVOLUTIONS, steps, endpoint=False)[:, None]
    elevation = np.radians(np.linspace(LOWEST, HIGHEST, beams))[None, :]
    level, up = np.cos(elevation), np.sin(elevation)
    x, y, z = np.broadcast_arrays(level * np.cos(azimuth), up, level * np.sin(azimuth))
    return np.stack([x, y, z], axis=-1)


def scan(tracer: clbvh.Tracer, positions: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the points that were hit, (m, 3), and their ranges, (m,), as a scanner with noise measures them."""
    # One position for all beams of a step: the two shapes are broadcast. Directions of length 1 make t a distance.
    hits = tracer.closest_hit(positions[:, None], directions)
    ray = hits.is_hit.nonzero()
    ranges = hits.t[ray] + np.random.default_rng(0).normal(scale=NOISE, size=hits.count)
    return positions[ray[0]] + ranges[:, None] * directions[ray], ranges


def colour(ranges: np.ndarray) -> np.ndarray:
    """Return (m, 3) uint8: the colour of each range."""
    near, far = np.quantile(ranges, [0.02, 0.98])
    share = np.clip((ranges - near) / max(far - near, 1e-9), 0, 1).round(1)
    stops = np.linspace(0, 1, len(COLOURS))
    return np.stack([np.interp(share, stops, COLOURS[:, band]) for band in range(3)], axis=-1).astype(np.uint8)


def draw(points: np.ndarray, colours: np.ndarray, camera: clbvh.Camera, width: int, height: int) -> np.ndarray:
    """Return a picture of a point cloud, (height, width, 3) uint8: the nearest point of each pixel."""
    right, up, forward = camera.axes()
    offset = points - camera.eye
    depth = offset @ forward
    focal = height / 2 / np.tan(np.radians(camera.fov) / 2)  # pixels
    column = np.floor(width / 2 + focal * (offset @ right) / depth).astype(int)
    row = np.floor(height / 2 - focal * (offset @ up) / depth).astype(int)
    picture = np.full((height, width, 3), 16, np.uint8)
    seen = (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    # The farthest first: where several points share a pixel, the last one written stays.
    order = np.flatnonzero(seen)[np.argsort(-depth[seen])]
    picture[row[order], column[order]] = colours[order]
    return picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", help="a mesh file; without it, mountains")
    parser.add_argument("-o", "--output", default="lidar-scan.png")
    parser.add_argument("--cloud", help="also write the point cloud, as a PLY file")
    parser.add_argument("--steps", type=int, default=720, help="pulses of each beam in one revolution")
    parser.add_argument("--beams", type=int, default=64)
    options = parser.parse_args()
    mesh = clbvh.load_mesh(options.mesh) if options.mesh else clbvh.make_shape("terrain", triangles=200_000, seed=7)

    positions, directions = fly(mesh, REVOLUTIONS * options.steps), aim(REVOLUTIONS * options.steps, options.beams)
    with clbvh.Tracer(mesh) as tracer:
        points, ranges = scan(tracer, positions, directions)
    colours = colour(ranges)

    size = np.ptp(mesh.vertices, axis=0).max()
    camera = clbvh.Camera(tuple(mesh.origin + size * np.array([-0.28, 0.42, 0.55])), tuple(mesh.origin), fov=40)
    imageio.imwrite(options.output, draw(points, colours, camera, 720, 405))
    if options.cloud:
        trimesh.PointCloud(points, colours).export(options.cloud)
    pulses = directions.shape[0] * directions.shape[1]
    print(
        f"{options.output}: {len(points):,} of {pulses:,} pulses came back, "
        f"from {ranges.min():.4g} to {ranges.max():.4g} away"
    )


if __name__ == "__main__":
    main()
