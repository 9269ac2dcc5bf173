"""Instructions and cache misses of a build, by Linux's `perf stat` where the machine has it.

A process builds some trees under perf, and another one more of them; the difference is the builds' alone, without
Python's start.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from functools import cache

from .bench import load_named_mesh
from .case import NotMeasuredError

EVENTS = {"instructions": "instructions", "cache-misses": "cache_misses"}

_FEW, _MANY = 1, 3
_TIMEOUT_S = 600


@cache
def find_problem() -> str:
    """Return why there are no hardware counters here; empty if there are."""
    if shutil.which("perf") is None:
        return "perf is not installed"
    try:
        counts = _run_perf([sys.executable, "-c", "pass"])
    except NotMeasuredError as error:
        return str(error)
    missing = [event for event in EVENTS if event not in counts]
    return f"perf does not count {', '.join(missing)} on this machine" if missing else ""


def count_build(mesh: str, builder: str) -> dict[str, float]:
    """Return the events of one build in one process, by the names in `EVENTS`.

    Raises
    ------
    NotMeasuredError
        perf fails.
    """
    few, many = (_run_perf([sys.executable, "-m", __name__, mesh, builder, str(count)]) for count in (_FEW, _MANY))
    return {name: (many[event] - few[event]) / (_MANY - _FEW) for event, name in EVENTS.items()}


def _run_perf(command: list[str]) -> dict[str, float]:
    """Return the counts of a command by event; those that are not supported are left out."""
    perf = ["perf", "stat", "-x", ",", "-e", ",".join(EVENTS), "--", *command]
    try:
        ended = subprocess.run(perf, capture_output=True, text=True, timeout=_TIMEOUT_S, check=True)
    except (OSError, subprocess.SubprocessError) as error:
        raise NotMeasuredError(f"perf stat fails: {error}") from error
    counts = {}
    for line in ended.stderr.splitlines():
        fields = line.split(",")
        if len(fields) > 2 and fields[0].replace(".", "").isdigit():
            counts[fields[2].partition(":")[0]] = float(fields[0])
    return counts


def _main(mesh_name: str, builder: str, count: str) -> None:
    """Build a tree some times; the first build also loads the compiled code."""
    from ..builders.build import build

    mesh = load_named_mesh(mesh_name)
    for _ in range(int(count)):
        build(mesh, builder=builder)


if __name__ == "__main__":
    _main(*sys.argv[1:])
