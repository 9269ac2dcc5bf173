"""Camera images for vision: depth, normals and object ids of a scene, as a calibrated camera sees them.

    python examples/camera_images.py [-o FOLDER] [--width 640]

Writes depth.png (16 bits, millimetres; 0: nothing), normals.png, ids.png and camera.json into the folder, and
overview.png. The axes are those of OpenCV: x right, y down, z forward. Lengths are in metres.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import trimesh

import clbvh

# fx, fy, cx, cy of a picture that is 640 x 480: a long lens, a little off the middle.
WIDTH, HEIGHT = 640, 480
INTRINSICS = np.array([[720.0, 0, 331.5], [0, 718.0, 236.0], [0, 0, 1]])

COLOURS = np.array(
    [[40, 42, 48], [196, 190, 180], [214, 104, 52], [70, 130, 180], [98, 160, 90], [170, 90, 160]], np.uint8
)


def make_table() -> tuple[trimesh.Trimesh, np.ndarray]:
    """Return a table with four things on it, z up, and the object of each face, (F,): 1 is the table."""
    place = trimesh.transformations.translation_matrix
    things = [
        trimesh.creation.box((1.6, 1.2, 0.05), place((0, 0, -0.025))),
        trimesh.creation.box((0.3, 0.2, 0.24), place((-0.35, 0.15, 0.12))),
        trimesh.creation.cylinder(0.1, 0.36, transform=place((0.12, 0.3, 0.18))),
        trimesh.creation.icosphere(4, 0.14).apply_translation((0.4, -0.05, 0.14)),
        trimesh.creation.torus(0.16, 0.05, transform=place((-0.12, -0.28, 0.05))),
    ]
    return trimesh.util.concatenate(things), np.repeat(np.arange(1, len(things) + 1), [len(t.faces) for t in things])


def look(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the pose of a camera, camera to world (4, 4), in the axes of OpenCV; z of the world is up."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], axis=1)
    return pose


def back_project(depth: np.ndarray, matrix: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return the points of a depth image in the world, (height, width, 3)."""
    rows, columns = np.indices(depth.shape)
    # Pixel centres lie at half numbers.
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(depth.shape)], axis=-1)
    return (depth[..., None] * (pixels @ np.linalg.inv(matrix).T)) @ pose[:3, :3].T + pose[:3, 3]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("camera-images"), help="a folder")
    parser.add_argument("--overview", type=Path, help="the file of the overview, if not overview.png in the folder")
    parser.add_argument("--width", type=int, default=WIDTH, help="pixels; the intrinsics are scaled")
    options = parser.parse_args()
    table, object_of_face = make_table()
    pose = look(np.array([0.9, -1.5, 1.0]), np.array([0, 0, 0.05]))
    camera = clbvh.Camera.from_intrinsics(INTRINSICS, pose, (WIDTH, HEIGHT), convention="opencv")
    width, height = options.width, options.width * HEIGHT // WIDTH
    matrix = camera.intrinsics(width, height)

    with clbvh.Tracer(table) as tracer:
        hits = tracer.closest_hit(*camera.rays(width, height))
    seen = hits.is_hit
    # t is the distance from the eye; depth is the part of it along the optical axis.
    depth = np.where(seen, hits.t * camera.cosines(width, height), np.nan)
    # Rows of the inverse of a rotation are its columns: this turns normals into the axes of the camera.
    normals = hits.normals @ pose[:3, :3]
    normals[normals[..., 2] > 0] *= -1  # towards the camera, whose z points away from it
    ids = np.where(seen, object_of_face[hits.prim_id], 0)

    difference = np.abs(back_project(depth, matrix, pose)[seen] - hits.locations[seen]).max()
    images = {
        "depth": np.where(seen, np.round(1000 * depth), 0).astype(np.uint16),
        "normals": np.nan_to_num(np.round(127.5 * (normals + 1))).astype(np.uint8),
        "ids": ids.astype(np.uint8),
    }
    options.output.mkdir(parents=True, exist_ok=True)
    for name, image in images.items():
        imageio.imwrite(options.output / f"{name}.png", image)
    description = {"K": matrix.tolist(), "camera_to_world": pose.tolist(), "width": width, "height": height}
    (options.output / "camera.json").write_text(json.dumps(description, indent=1))

    near, far = depth[seen].min(), depth[seen].max()
    grey = np.where(seen, 255 - 205 * (depth - near) / (far - near), 40).astype(np.uint8)
    panels = [np.repeat(grey[..., None], 3, axis=2), images["normals"], COLOURS[ids]]
    imageio.imwrite(options.overview or options.output / "overview.png", np.hstack(panels))
    print(
        f"{options.output}: {width} x {height}, depth from {near:.4g} to {far:.4g} m, "
        f"{len(np.unique(ids[seen]))} objects"
    )
    print(f"points from depth and intrinsics agree with the hits within {difference:.1e} m")


if __name__ == "__main__":
    main()
