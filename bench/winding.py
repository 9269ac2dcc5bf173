"""Winding numbers beside libigl's: ``python bench/winding.py FILE ...``, after ``pip install libigl``.

200,000 points in a box 1.2 times as large as each mesh. The engines take turns, each in a process of its own: the ratio
of the wall times, libigl's over ours, the median of five turns, without the building of trees; once with the default
error and once with an error as small as libigl's, by the root mean square at 20,000 of the points.
"""

import multiprocessing
import sys
import time
from statistics import median

import numpy as np

import clbvh

# The default, and half of it.
MAX_ERRORS = 0.01, 0.005
EXACT = 20_000


def serve(pipe):
    """Answer for one mesh after another: the times of the engine for its points, and its winding numbers."""
    for mesh, points, max_error in iter(pipe.recv, None):
        if max_error is None:
            import igl

            # Each call builds a tree: that of one point has its time.
            (tree_s, _), (call_s, numbers) = (
                clock(igl.fast_winding_number, mesh.vertices, mesh.faces.astype(np.int64), chosen)
                for chosen in (points[:1], points)
            )
            pipe.send((call_s - tree_s, np.asarray(numbers)))
            continue
        with clbvh.Tracer(mesh) as tracer:
            tracer.winding_number(points[:1])
            pipe.send(clock(tracer.winding_number, points, max_error=max_error))


def clock(task, *arguments, **more):
    """Return the wall time and the result of a call."""
    begin = time.perf_counter()
    result = task(*arguments, **more)
    return time.perf_counter() - begin, result


def compare(path, pipes):
    """Print the times and errors of both engines for one mesh, and return the ratios of the times."""
    mesh = clbvh.load_mesh(path)
    lower, upper = (find(mesh.vertices[mesh.faces], axis=(0, 1)) for find in (np.min, np.max))
    reach = 0.6 * (upper - lower).max()
    points = (lower + upper) / 2 + np.random.default_rng(1).uniform(-reach, reach, (200_000, 3))
    with clbvh.Tracer(mesh) as tracer:
        exact = tracer.winding_number(points[:EXACT], max_error=0)

    def ask(pipe, max_error):
        pipe.send((mesh, points, max_error))
        seconds, numbers = pipe.recv()
        return seconds, np.sqrt(np.mean((numbers[:EXACT] - exact) ** 2))

    (_, target), (_, high), (_, low) = (
        ask(pipes[max_error is not None], max_error) for max_error in (None, *MAX_ERRORS)
    )
    # Errors are nearly a power of the error that is asked for.
    equal = MAX_ERRORS[1] * (target / low) ** (np.log(MAX_ERRORS[0] / MAX_ERRORS[1]) / np.log(high / low))
    turns = [[ask(pipes[0], None), *(ask(pipes[1], each) for each in (MAX_ERRORS[0], equal))] for _ in range(5)]
    errors = " ".join(f"{error:.5f}" for _, error in turns[0])
    ratios = [median(turn[0][0] / turn[which][0] for turn in turns) for which in (1, 2)]
    print(f"{mesh.name:28} {mesh.face_count:8,}  errors {errors}  ratios {ratios[0]:.2f} {ratios[1]:.2f}", flush=True)
    return ratios


def main(paths):
    context = multiprocessing.get_context("spawn")
    pipes = []
    for _ in range(2):
        near, far = context.Pipe()
        context.Process(target=serve, args=(far,), daemon=True).start()
        pipes.append(near)
    print("errors of libigl and of ours, by default and as small; ratios of the latter")
    ratios = np.array([compare(path, pipes) for path in paths])
    print("medians", *np.median(ratios, axis=0).round(2), "of", len(paths))
    for pipe in pipes:
        pipe.send(None)


if __name__ == "__main__":
    main(sys.argv[1:])
