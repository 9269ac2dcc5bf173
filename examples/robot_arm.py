"""A robot arm reaches over a table: its clearance at each step, and what the camera over the table sees.

    python examples/robot_arm.py [-o robot-arm.png] [--steps 60] [--width 720]

The picture is the tightest step; the way between the closest points is yellow.
"""

from __future__ import annotations

import argparse

import numpy as np

import clbvh

LENGTHS = (0.20, 0.42, 0.36, 0.14, 0.16)  # of the links, metres
AXES = "zyyyz"  # about which each joint turns
START, GOAL = np.array([-70, 20, 75, 30, 0]), np.array([75, 35, 62, 40, 90])  # degrees


def turn(axis: str, degrees: float) -> np.ndarray:
    """Return the matrix of a rotation about an axis."""
    return clbvh.Transform(rotate=tuple(degrees * (axis == each) for each in "xyz")).matrix


def list_poses(degrees: np.ndarray) -> list[np.ndarray]:
    """Return the pose of each link of the arm: forward kinematics."""
    poses, joint = [], np.eye(4)
    for axis, angle, length in zip(AXES, degrees, LENGTHS, strict=True):
        poses.append(joint @ turn(axis, angle))
        joint = poses[-1] @ clbvh.Transform(translate=(0, 0, length)).matrix
    return poses


def build_scene() -> tuple[clbvh.Scene, list[clbvh.Instance], list[clbvh.Instance]]:
    """Return the scene, the links of the arm, and the things around it."""
    scene, cube = clbvh.Scene(), clbvh.make_shape("cube", triangles=12)
    ball = clbvh.make_shape("icosphere", triangles=2000)
    arm, things = [], []
    for number, length in enumerate(LENGTHS):
        link = clbvh.Transform(scale=(0.05, 0.05, length / 2 + 0.04), translate=(0, 0, length / 2)).apply(ball)
        arm.append(scene.place(scene.add(link), name=f"link {number}", colour=(0.8, 0.25, 0.05)))
    box, knot = scene.add(cube), scene.add(clbvh.make_shape("knot", triangles=20_000))
    for name, scale, place in (
        ("table", (1.8, 1.8, 0.04), (0, 0, -0.06)),
        ("post", (0.08, 0.08, 0.26), (0.66, -0.14, 0.09)),
    ):
        transform = clbvh.Transform(scale=scale, translate=place)
        things.append(scene.place(box, transform, name=name, colour=(0.35, 0.4, 0.45)))
    transform = clbvh.Transform(scale=0.04, rotate=(90, 0, 0), translate=(0.5, 0.42, 0.09))
    things.append(scene.place(knot, transform, name="knot", colour=(0.1, 0.35, 0.3)))
    return scene, arm, things


def sweep(tracer: clbvh.Tracer, arm: list, things: list, steps: int) -> list[clbvh.ClosestPair]:
    """Return where arm and things are closest at each step of the way from start to goal."""
    found = []
    for share in np.linspace(0, 1, steps):
        tracer.set_transforms(arm, list_poses(START + share * (GOAL - START)))
        found.append(tracer.closest_pair(arm[1:], things))
    return found


def draw(scene: clbvh.Scene, arm: list, poses: list, pair: clbvh.ClosestPair, width: int, path: str) -> None:
    """Write a picture of the arm in a pose, with the closest points and the way between them."""
    picture = clbvh.Scene()
    for each in scene.instances:
        matrix = poses[each.id] if each.id < len(arm) else each.matrix
        picture.place(picture.add(each.geometry.shape), matrix, colour=each.colour)
    a, b = pair.points
    way = a + np.linspace(0, 1, 40)[:, None] * (b - a)
    marks = clbvh.Spheres(np.vstack([way, a, b]), [0.006] * len(way) + [0.016] * 2)
    picture.place(picture.add(marks), colour=(1.0, 0.75, 0.0))
    camera = clbvh.Camera(eye=(1.9, -1.2, 1.0), look_at=(0.25, 0.05, 0.17), up=(0, 0, 1), fov=25)
    view = clbvh.View(width=width, height=width * 9 // 16, camera=camera, shading="studio", samples=8)
    clbvh.render(picture, view).save(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", default="robot-arm.png")
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--width", type=int, default=720, help="pixels of the picture")
    options = parser.parse_args()
    scene, arm, things = build_scene()
    over_table = clbvh.Camera(eye=(0.2, 0.1, 2.5), look_at=(0.2, 0.1, 0), up=(0, 1, 0), fov=40)
    with clbvh.Tracer(scene) as tracer:
        pairs = sweep(tracer, arm, things, options.steps)
        step = int(np.argmin([pair.distance for pair in pairs]))
        poses = list_poses(START + step / (options.steps - 1) * (GOAL - START))
        tracer.set_transforms(arm, poses)
        touching = [pair for pair in tracer.collisions(arm).tolist() if pair[1] - pair[0] > 1]
        hits = tracer.closest_hit(*over_table.rays(320, 240))
    tightest = pairs[step]
    link, thing = (scene.instances[each].name for each in tightest.instance_ids)
    seen = np.isin(hits.instance_id, [each.id for each in arm]).mean()
    draw(scene, arm, poses, tightest, options.width, options.output)
    print(
        f"{options.output}: step {step} of {options.steps}, {1e3 * tightest.distance:.1f} mm from {link} to the {thing}"
    )
    print(
        f"links that touch others than their neighbours: {len(touching)}; the arm fills {seen:.1%} of the camera image"
    )


if __name__ == "__main__":
    main()
