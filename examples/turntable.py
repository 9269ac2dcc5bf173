"""A turntable, and picking: frames around a mesh, with the point under one pixel followed through all of them.

    python examples/turntable.py [MESH] [-o turntable.gif] [--sheet turntable.png] [--frames 36] [--pick 180 168]

Without a mesh it shows a knot. The tree is built and put on the device once, for all frames.
"""

from __future__ import annotations

import argparse

import imageio.v3 as imageio
import numpy as np

import clbvh

WIDTH, HEIGHT = 360, 240  # pixels
SHEET_FRAMES = 4  # of the contact sheet, two in a row
SEEN, HIDDEN, DARK = (255, 196, 40), (110, 130, 160), (40, 40, 40)
RADIUS = 9  # of the mark, pixels


def pick(picture: clbvh.Picture, column: int, row: int) -> clbvh.Hits:
    """Return the hit under a pixel."""
    hits = picture.hits
    if not hits.is_hit[row, column]:
        raise SystemExit(f"nothing is under pixel {column}, {row}: take one of the mesh")
    return hits[row, column]


def find_pixel(camera: clbvh.Camera, point: np.ndarray) -> tuple[int, int]:
    """Return the column and row of a point in front of the camera; it may lie outside the picture."""
    # Homogeneous image coordinates: pixels to the right and downwards, times the depth.
    x, y, depth = camera.intrinsics(WIDTH, HEIGHT) @ (np.linalg.inv(camera.camera_to_world()) @ [*point, 1])[:3]
    return int(np.floor(x / depth)), int(np.floor(y / depth))


def is_seen(tracer: clbvh.Tracer, camera: clbvh.Camera, hit: clbvh.Hits) -> bool:
    """Return whether nothing is between the eye and a point of the surface."""
    # From the point, just off its own surface, to the eye.
    start = hit.offset_origins(towards=camera.eye - hit.locations)
    return not tracer.any_hit(start, camera.eye - start, t_max=1)


def mark(rgb: np.ndarray, column: int, row: int, colour: tuple[int, int, int]) -> None:
    """Draw a ring around a pixel, with a dark edge on both sides."""
    rows, columns = np.indices(rgb.shape[:2])
    distance = np.hypot(rows - row, columns - column)
    rgb[np.abs(distance - RADIUS) < 2.5] = DARK
    rgb[np.abs(distance - RADIUS) < 1.5] = colour


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", help="a mesh file; without it, a knot")
    parser.add_argument("-o", "--output", default="turntable.gif")
    parser.add_argument("--sheet", help="also write four frames side by side, as a PNG file")
    parser.add_argument("--frames", type=int, default=36)
    parser.add_argument("--pick", type=int, nargs=2, metavar=("COLUMN", "ROW"), default=(180, 168))
    options = parser.parse_args()
    mesh = clbvh.load_mesh(options.mesh) if options.mesh else clbvh.make_shape("knot", triangles=50_000)
    bvh = clbvh.build(mesh)

    frames = []
    with clbvh.Renderer(bvh) as renderer, clbvh.Tracer(bvh) as tracer:
        cameras = renderer.turntable(options.frames, width=WIDTH, height=HEIGHT)
        first = renderer.render(camera=cameras[0], width=WIDTH, height=HEIGHT)
        hit = pick(first, *options.pick)
        for camera in cameras:
            rgb = renderer.render(camera=camera, width=WIDTH, height=HEIGHT).rgb.copy()
            mark(rgb, *find_pixel(camera, hit.locations), SEEN if is_seen(tracer, camera, hit) else HIDDEN)
            frames.append(rgb)

    imageio.imwrite(options.output, frames, duration=1000 * 6 // options.frames, loop=0)
    if options.sheet:
        chosen = [frames[number * options.frames // SHEET_FRAMES] for number in range(SHEET_FRAMES)]
        imageio.imwrite(options.sheet, np.vstack([np.hstack(chosen[:2]), np.hstack(chosen[2:])]))
    print(f"{options.output}: {options.frames} frames; picked: {hit}")


if __name__ == "__main__":
    main()
