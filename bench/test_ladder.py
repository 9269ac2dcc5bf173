"""What each variant of the report's ladder takes, phase by phase.

Variants take turns, so that a drift of the machine's speed meets all of them. What is printed is the fastest run of
each: whatever else the machine does can only add to it.
"""

from __future__ import annotations

import pytest

import clbvh
from clbvh.builders.build import build_tree
from clbvh.builders.ladder.variants import VARIANTS
from clbvh.views.cameras.framing import frame_mesh

RUNS = 9
WORKERS = (1, 2)

# Seconds each: fewer runs.
SLOW = ("sequential", "naive", "range", "cached")
SLOW_RUNS = 2

# The report's range of frontiers, on a picture of this size.
FRONTIERS = (4, 16, 64, 256, 1024, 4096, 8192)
WIDTH, HEIGHT = 800, 450

# Linked nodes become rows because a Bvh has rows; the report's variants of these names did not need it.
NOT_THE_BUILD = "convert"


def test_ladder(mesh):
    options = clbvh.BuildOptions(bins=8)
    taken = {(name, workers): [] for name in VARIANTS for workers in WORKERS}
    with clbvh.SubtreePool(1) as one, clbvh.SubtreePool(2) as two:
        for run in range(RUNS):
            for (name, workers), laps in taken.items():
                if run < SLOW_RUNS or name not in SLOW:
                    laps.append(dict(build_tree(mesh, name, {1: one, 2: two}[workers], options).timings_ms))
    print(f"\n{'variant':12}{'workers':>8}{'build ms':>10}  phases")
    for (name, workers), laps in taken.items():
        best = min(laps, key=_build_ms)
        phases = ", ".join(f"{lap} {ms:.0f}" for lap, ms in best.items())
        print(f"{name:12}{workers:8}{_build_ms(best):10.0f}  {phases}")


@pytest.mark.parametrize("layout", ["bvh2", "bvh8"])
def test_frontier(mesh, layout):
    """What a leaf that is tested by brute force saves in the build, and costs in the kernel."""
    camera = frame_mesh(mesh, aspect=WIDTH / HEIGHT)
    origins, directions = (rays.reshape(-1, 3) for rays in camera.rays(WIDTH, HEIGHT))
    print(f"\n{layout}: {'frontier':>8}{'build ms':>10}{'kernel ms':>11}")
    for frontier in FRONTIERS:
        bvh = clbvh.build(mesh, builder="frontier", frontier=frontier)
        build_ms = min(_build_ms(clbvh.build(mesh, builder="frontier", frontier=frontier).timings_ms) for _ in range(3))
        with clbvh.Tracer(bvh, layout=layout) as tracer:
            tracer.closest_hit(origins, directions)
            before = tracer.timings_ms["kernel"]
            tracer.closest_hit(origins, directions)
            print(f"{'':6}{frontier:8}{build_ms:10.0f}{tracer.timings_ms['kernel'] - before:11.0f}")


def _build_ms(laps):
    return sum(ms for lap, ms in laps.items() if lap != NOT_THE_BUILD)
