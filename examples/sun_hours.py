"""Hours of sun on the ground and the houses of a city on one day, as a picture.

    python examples/sun_hours.py [-o sun-hours.png] [--latitude 48] [--day 80] [--blocks 7] [--cell 2]

The sun's path is a formula here; `pvlib.solarposition` has that of a place and a time. In metres; z is up, y north.
"""

from __future__ import annotations

import argparse

import imageio.v3 as imageio
import numpy as np

import clbvh
import clbvh.radiation

STREET, BLOCK = 20.0, 40.0
STEP_HOURS = 0.25

# From no sun to most of it: dark blue, violet, orange, yellow, white. Linear between these colours.
COLOURS = np.array([[18, 22, 60], [105, 45, 130], [225, 110, 70], [250, 205, 90], [255, 255, 225]])


def grid(corner: np.ndarray, side: np.ndarray, other: np.ndarray, cell: float) -> np.ndarray:
    """Return the triangles of a rectangle, (n, 3, 3), in cells of about a size; they face along side x other."""
    counts = [max(1, round(float(np.linalg.norm(each)) / cell)) for each in (side, other)]
    i, j = np.meshgrid(*map(np.arange, counts), indexing="ij")

    def at(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return corner + (a / counts[0])[..., None] * side + (b / counts[1])[..., None] * other

    a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
    return np.concatenate((np.stack((a, b, c), axis=-2), np.stack((a, c, d), axis=-2))).reshape(-1, 3, 3)


def build_city(blocks: int, cell: float, seed: int = 4) -> clbvh.Mesh:
    """Return the ground and a house on each block, without the ground below it."""
    random = np.random.default_rng(seed)
    x, y, z = np.eye(3)
    pitch = STREET + BLOCK
    triangles = []
    for row in range(blocks):
        for column in range(blocks):
            corner = np.array([column * pitch, row * pitch, 0.0])
            width, depth = random.uniform(0.5, 1, 2) * BLOCK
            height = random.choice([9, 12, 15, 18, 24, 45], p=[0.2, 0.25, 0.25, 0.15, 0.1, 0.05])
            roof = corner + height * z
            triangles += [
                grid(roof, width * x, depth * y, cell),
                grid(corner, width * x, height * z, cell),
                grid(corner + width * x, depth * y, height * z, cell),
                grid(corner + width * x + depth * y, -width * x, height * z, cell),
                grid(corner + depth * y, -depth * y, height * z, cell),
                grid(corner + width * x, (pitch - width) * x, depth * y, cell),
                grid(corner + depth * y, pitch * x, (pitch - depth) * y, cell),
            ]
    corners = np.concatenate(triangles)
    return clbvh.Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def follow_sun(latitude: float, day: int) -> np.ndarray:
    """Return directions to the sun while it is up, (n, 3), one for each step; noon is in the south."""
    hours = np.arange(0, 24, STEP_HOURS) + STEP_HOURS / 2
    turn, north = np.radians(15 * (hours - 12)), np.radians(latitude)
    tilt = np.radians(-23.44) * np.cos(2 * np.pi * (day + 10) / 365)
    east = -np.cos(tilt) * np.sin(turn)
    y = np.sin(tilt) * np.cos(north) - np.cos(tilt) * np.cos(turn) * np.sin(north)
    up = np.sin(tilt) * np.sin(north) + np.cos(tilt) * np.cos(turn) * np.cos(north)
    suns = np.stack([east, y, up], axis=-1)
    return suns[up > 0]


def paint(mesh: clbvh.Mesh, hours: np.ndarray) -> clbvh.Mesh:
    """Return the mesh in the colours of the hours of its faces."""
    stops = np.linspace(0, hours.max(), len(COLOURS))
    colours = np.stack([np.interp(hours, stops, COLOURS[:, band]) for band in range(3)], axis=-1).astype(np.uint8)
    looks = clbvh.Appearance(colours=np.repeat(colours[:, None], 3, axis=1))
    return clbvh.Mesh.from_arrays(mesh.vertices, mesh.faces, appearance=looks)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", default="sun-hours.png")
    parser.add_argument("--latitude", type=float, default=48, help="degrees north")
    parser.add_argument("--day", type=int, default=80, help="of the year; 80 is the beginning of spring")
    parser.add_argument("--blocks", type=int, default=7)
    parser.add_argument("--cell", type=float, default=2, help="metres")
    parser.add_argument("--width", type=int, default=640)
    options = parser.parse_args()
    mesh = build_city(options.blocks, options.cell)
    suns = follow_sun(options.latitude, options.day)
    with clbvh.Tracer(mesh) as tracer:
        faces = tracer.points_on(range(mesh.face_count))
        hours = clbvh.radiation.sun_hours(tracer, faces, suns, weights=STEP_HOURS)
    middle, size = mesh.vertices.mean(axis=0), np.ptp(mesh.vertices, axis=0).max()
    camera = clbvh.Camera(eye=middle + size * np.array([-0.5, -0.95, 0.75]), look_at=middle, up=(0, 0, 1), fov=45)
    view = clbvh.View(shading="albedo", camera=camera, width=options.width, height=options.width * 9 // 16)
    imageio.imwrite(options.output, clbvh.render(paint(mesh, hours), view).rgb)
    print(
        f"{options.output}: {mesh.face_count:,} faces, {len(suns)} suns: {hours.min():.1f} to {hours.max():.1f} hours"
    )


if __name__ == "__main__":
    main()
