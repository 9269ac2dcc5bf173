"""Moves of a tracer's objects against a new tracer: `python bench/moves.py`.

Prints the processor time of all threads in milliseconds, medians of five after a first one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

import numpy as np

import clbvh

ROUNDS = 5
TRIANGLES = 100_000


def measure(call: Callable[[], object]) -> float:
    """Return the median time of a call in ms."""
    times = []
    for _ in range(ROUNDS + 1):
        begin = time.process_time()
        call()
        times.append(1e3 * (time.process_time() - begin))
    return median(times[1:])


def report(title: str, source: clbvh.Scene | clbvh.Mesh, move: Callable[..., object], *arguments: object) -> None:
    """Print the time of a move beside that of a tracer that is opened and closed."""
    move_ms, open_ms = measure(lambda: move(*arguments)), measure(lambda: clbvh.Tracer(source).close())
    print(f"{title}: {move_ms:.1f} ms, a new tracer {open_ms:.1f} ms")


def main() -> None:
    for count in (1000, 10_000):
        scene = clbvh.Scene()
        transforms = np.tile(np.eye(4), (count, 1, 1))
        transforms[:, 0, 3] = np.arange(count)
        copies = scene.place_many(scene.add(clbvh.make_shape("cube", triangles=12)), transforms)
        with clbvh.Tracer(scene) as tracer:
            report(f"set_transforms, {count:,} instances", scene, tracer.set_transforms, copies, transforms)
    knot = clbvh.make_shape("knot", triangles=TRIANGLES)
    wobbling = knot.vertices * [1, 1, 1.01]
    scene = clbvh.Scene()
    geometry = scene.add(knot)
    scene.place(geometry)
    with clbvh.Tracer(scene) as tracer:
        report("set_vertices", scene, tracer.set_vertices, geometry, wobbling)
    with clbvh.Tracer(knot) as tracer:
        report("update", knot, tracer.update, wobbling)
    scene = clbvh.Scene()
    centres = np.random.default_rng(0).random((TRIANGLES, 3))
    cloud = scene.add(clbvh.Spheres(centres, 0.005))
    scene.place(cloud)
    with clbvh.Tracer(scene) as tracer:
        report("set_spheres", scene, tracer.set_spheres, cloud, centres)


if __name__ == "__main__":
    main()
