"""A mesh of small triangles on a ground of two large ones: as one mesh, over the same as two instances.

    python -m bench.scales [--half 1e4 3e4 2e7]

Prints whole calls in milliseconds, medians of seven in turn, and their ratio.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np

import clbvh

from .paired import compare, measure_ms


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
    calls = {
        "picture": ("closest_hit", origins, directions),
        "scattered": ("closest_hit", starts, ways),
        "counts": ("count_hits", starts, ways),
        "points": ("closest_point", points),
    }
    for half in halves:
        ground = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) - [0, 0, 1.5]
        square = np.array([[0, 1, 2], [0, 2, 3]])
        scene = clbvh.Scene()
        scene.place(scene.add(clbvh.Mesh.from_arrays(vertices, knot.faces)))
        scene.place(scene.add(clbvh.Mesh.from_arrays(ground, square)))
        joined = clbvh.Mesh.from_arrays(
            np.concatenate((vertices, ground)), np.concatenate((knot.faces, square + len(vertices)))
        )
        with clbvh.Tracer(joined) as one, clbvh.Tracer(scene) as two:
            for name, (query, *rays) in calls.items():
                tasks = [partial(measure_ms, partial(getattr(tracer, query), *rays)) for tracer in (one, two)]
                compare(f"{half:g} {name}, one mesh, two instances", *tasks)


if __name__ == "__main__":
    main()
