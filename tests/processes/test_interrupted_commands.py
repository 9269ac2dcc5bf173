"""Ctrl-C and SIGTERM at any moment: one line, the exit code, and nothing left behind."""

from __future__ import annotations

import os
import random
import signal

import pytest

from ..profiles import is_long
from .place import Place, scene_in

COMMANDS = {
    "render": ("render", "scene.toml", "-o", "a.png", "--hits", "a.npz", "--cache"),
    "workers": ("render", "scene.toml", "-o", "a.png", "--workers", 2),
    "stats": ("stats", "scene.toml"),
    "stats-workers": ("stats", "scene.toml", "--workers", 2, "--rays"),
    "devices": ("devices",),
    "doctor": ("doctor",),
    "fetch": ("fetch", "--list"),
}
# These print line by line; the others print once all is done.
PRINTS_EARLY = ("devices", "doctor", "fetch")

# LLVM, inside PoCL, removes its files at once when a signal comes, and may miss them before clbvh is heard.
COMPILERS_LAST_WORD = "1 error generated."

MOMENTS = 200 if is_long() else 2

# Later than the usual end by this share, so that the end itself is tried.
_BEYOND = 1.05


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return scene_in(Place(tmp_path_factory.mktemp("f")))


def find_problem(place, outcome, name, usual_line_count):
    """Return what is wrong about a command that was interrupted, or that ended just before; empty if nothing is."""
    code, output, errors = outcome
    said = [] if code == 0 else ["clbvh: interrupted"]
    checks = {
        "exit code": code in (0, 130),
        "traceback": "Traceback" not in errors and "Error" not in errors,
        "message": [line for line in errors.splitlines() if line != COMPILERS_LAST_WORD] == said,
        "half output": code == 0 or output.count("\n") in (0, usual_line_count) or name in PRINTS_EARLY,
        "leftovers": place.leftovers() == [],
        "last line": not said or errors.endswith("clbvh: interrupted\n"),
        "files": {path.name for path in place.output.iterdir()} <= {"scene.toml", "a.png", "a.npz"},
    }
    failed = [check for check, holds in checks.items() if not holds]
    return f"{', '.join(failed)}: {outcome} {place.leftovers()}" if failed else ""


# The others differ in nothing that is interrupted.
NAMES = COMMANDS if is_long() else ("render", "workers", "fetch")


@pytest.mark.parametrize("name", NAMES)
def test_ctrl_c_at_any_moment_leaves_nothing(place, name):
    words = COMMANDS[name]
    code, output, _ = place.run(*words)
    assert code == 0
    usual_s = min(place.time(*words) for _ in range(2))
    moments = random.Random(f"Ctrl-C, {name}")
    problems, interrupted = [], 0
    for _ in range(MOMENTS):
        moment_s = moments.uniform(0, _BEYOND * usual_s)
        outcome = place.signal_at(moment_s, signal.SIGINT, *words)
        interrupted += outcome[0] == 130
        if problem := find_problem(place, outcome, name, output.count("\n")):
            problems.append(f"after {moment_s:.3f} of {usual_s:.3f} s: {problem}")
    print(f"{name}: {interrupted} of {MOMENTS} interrupted, slowest {place.slowest_end_s:.2f} s")
    assert problems == []
    # The few moments of a short run may all be late, where the machine was busy when the time was taken.
    assert interrupted > 0 or not is_long()


def test_sigterm_is_exit_code_143(place):
    code, output, errors = place.signal_at(0.6, signal.SIGTERM, *COMMANDS["workers"])
    assert (code, output) == (143, "")
    assert [line for line in errors.splitlines() if line != COMPILERS_LAST_WORD] == ["clbvh: terminated"]
    assert place.leftovers() == []


def test_an_ignored_ctrl_c_stays_ignored(place):
    # A job in the background, as shells start it.
    process = place.start(*COMMANDS["stats"], ignore_interrupts=True)
    os.killpg(process.pid, signal.SIGINT)
    code, _, errors = place.finish(process)
    assert (code, errors) == (0, "")
