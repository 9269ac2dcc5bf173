"""Meshes that move, and tracers that open: each against the way that keeps nothing."""

from __future__ import annotations

import time

import numpy as np
import pytest

import clbvh

from .paired import compare, measure_ms

TRIANGLES = 100_000
# Frames of one run, and of one run of new tracers: both figures are for one frame.
FRAMES, NEW_TRACERS = 20, 4


def _deform(vertices: np.ndarray, frame: int) -> np.ndarray:
    """Return vertices that wobble by a fiftieth of the mesh."""
    size = np.ptp(vertices)
    return vertices + 0.02 * size * np.sin(vertices[:, ::-1] / size * 9 + 0.3 * frame)


@pytest.mark.parametrize("layout", ["auto", "bvh2", "bvh4", "bvh8"])
def test_an_update_against_a_new_tracer(layout):
    """The aim is a ratio of 0.05 or less."""
    mesh = clbvh.make_shape("knot", triangles=TRIANGLES)
    frames = [_deform(mesh.vertices, frame) for frame in range(FRAMES)]

    def open_new(vertices: np.ndarray) -> None:
        with clbvh.Tracer(mesh.with_vertices(vertices), layout=layout):
            pass

    with clbvh.Tracer(mesh, layout=layout) as tracer:
        compare(
            f"update, new tracer ({tracer.layout}), {mesh.face_count:,} triangles",
            lambda: measure_ms(lambda: [tracer.update(vertices) for vertices in frames]) / FRAMES,
            lambda: measure_ms(lambda: [open_new(vertices) for vertices in frames[:NEW_TRACERS]]) / NEW_TRACERS,
        )


def test_opening_a_second_tracer():
    """A tracer over 12 triangles opens in 3 ms at most, and its first ray adds little to a later one."""
    bvh = clbvh.build(clbvh.make_shape("boxes", triangles=12))
    rays = np.array([[[0.1, 0.2, 9.0]], [[0.0, 0.0, -1.0]]])
    times: dict[str, list[float]] = {"open": [], "first ray": [], "second ray": [], "close": []}
    for _ in range(100):
        marks = [time.perf_counter()]
        tracer = clbvh.Tracer(bvh)
        marks.append(time.perf_counter())
        for _ in range(2):
            tracer.closest_hit(*rays)
            marks.append(time.perf_counter())
        tracer.close()
        marks.append(time.perf_counter())
        for name, step in zip(times, np.diff(marks), strict=True):
            times[name].append(step * 1e3)
    print("\n" + ", ".join(f"{name} {np.median(steps):.2f} ms" for name, steps in times.items()))
