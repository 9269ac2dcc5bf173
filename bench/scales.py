"""A mesh of small triangles on a ground of two large ones: as one mesh, over the same as two instances.

    python bench/scales.py [--half 1e4 3e4 2e7]

Prints whole calls in milliseconds, medians of seven in turn, and their ratio.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import ExitStack

import numpy as np

import clbvh

CALLS = 7


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--half", nargs="+", type=float, default=[1e4, 3e4, 2e7], help="half sizes of the ground")
    halves = parser.parse_args().half
    knot = clbvh.make_shape("knot", triangles=400_000)
    vertices = knot.vertices - knot.bounds.mean(axis=0)
    vertices /= np.abs(vertices).max()
    generator = np.random.default_rng(0)
    origins, directions = clbvh.Camera(eye=(0.5, -2.5, 1.5), look_at=(0, 0, 0)).rays(1200, 800)
    starts, ways = generator.uniform(-1, 1, (500_000, 3)), generator.normal(size=(500_000, 3))
    points = generator.uniform(-1, 1, (200_000, 3))
    for half in halves:
        ground = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) - [0, 0, 1.5]
        square = np.array([[0, 1, 2], [0, 2, 3]])
        scene = clbvh.Scene()
        scene.place(scene.add(clbvh.Mesh.from_arrays(vertices, knot.faces)))
        scene.place(scene.add(clbvh.Mesh.from_arrays(ground, square)))
        joined = clbvh.Mesh.from_arrays(
            np.concatenate((vertices, ground)), np.concatenate((knot.faces, square + len(vertices)))
        )
        with ExitStack() as stack:
            one, two = (stack.enter_context(clbvh.Tracer(source)) for source in (joined, scene))
            compare(f"{half:g} picture", lambda t: t.closest_hit(origins, directions), one, two)
            compare(f"{half:g} scattered", lambda t: t.closest_hit(starts, ways), one, two)
            compare(f"{half:g} counts", lambda t: t.count_hits(starts, ways), one, two)
            compare(f"{half:g} points", lambda t: t.closest_point(points), one, two)


def compare(name: str, call: Callable[[clbvh.Tracer], object], one: clbvh.Tracer, two: clbvh.Tracer) -> None:
    """Print what a call takes of both tracers, in turn."""
    times: dict[clbvh.Tracer, list[float]] = {one: [], two: []}
    for _ in range(CALLS + 1):
        for tracer, taken in times.items():
            begin = time.perf_counter()
            call(tracer)
            taken.append(1e3 * (time.perf_counter() - begin))
    of_one, of_two = (float(np.median(taken[1:])) for taken in times.values())
    print(
        f"{name:20} one mesh {of_one:7.1f} ms, two instances {of_two:7.1f} ms, ratio {of_one / of_two:.2f}", flush=True
    )


if __name__ == "__main__":
    main()
