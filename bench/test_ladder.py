"""What each rung of the report's ladder takes, phase by phase.

Rungs take turns, so that a drift of the machine's speed meets all of them. What is printed is the fastest run of
each: whatever else the machine does can only add to it.
"""

from __future__ import annotations

import clbvh
from clbvh.build.ladder import LADDER

RUNS = 9
WORKERS = (1, 2)

# Seconds each: fewer runs.
SLOW = ("sequential", "naive", "range", "cached")
SLOW_RUNS = 2

# Linked nodes become rows because a Bvh has rows; the report's rungs of these names did not need it.
NOT_THE_BUILD = "convert"


def test_ladder(mesh):
    options = clbvh.BuildOptions(bins=8)
    taken = {(name, workers): [] for name in LADDER for workers in WORKERS}
    with clbvh.SubtreePool(1) as one, clbvh.SubtreePool(2) as two:
        for run in range(RUNS):
            for (name, workers), laps in taken.items():
                if run < SLOW_RUNS or name not in SLOW:
                    laps.append(dict(LADDER[name](mesh, {1: one, 2: two}[workers], options).timings_ms))
    print(f"\n{'rung':12}{'workers':>8}{'build ms':>10}  phases")
    for (name, workers), laps in taken.items():
        best = min(laps, key=_build_ms)
        phases = ", ".join(f"{lap} {ms:.0f}" for lap, ms in best.items())
        print(f"{name:12}{workers:8}{_build_ms(best):10.0f}  {phases}")


def _build_ms(laps):
    return sum(ms for lap, ms in laps.items() if lap != NOT_THE_BUILD)
