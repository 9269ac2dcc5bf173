"""Ctrl-C and SIGTERM at any moment: one line, the exit code, and nothing left behind."""

from __future__ import annotations

import random
import signal

import pytest

from ..profiles import is_long
from .command import Place

SCENE = '[mesh]\nshape = "knot"\ntriangles = 20000\n[image]\nwidth = 64\nheight = 40\n'

COMMANDS = {
    "render": ("render", "scene.toml", "-o", "a.png", "--hits", "a.npz", "--cache"),
    "workers": ("render", "scene.toml", "-o", "a.png", "--workers", 2),
    "stats": ("stats", "scene.toml"),
    "stats-workers": ("stats", "scene.toml", "--workers", 2, "--rays"),
    "devices": ("devices",),
    "doctor": ("doctor",),
    "fetch": ("fetch", "--list"),
}
MOMENTS = 200 if is_long() else 12

# Later than the usual end by this share, so that the end itself is tried.
_BEYOND = 1.05


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = Place(tmp_path_factory.mktemp("f"))
    (place.output / "scene.toml").write_text(SCENE)
    return place


def is_clean(place, outcome, name):
    """Check the outcome of a command that was interrupted, or ended just before."""
    code, output, errors = outcome
    assert "Traceback" not in errors
    assert "Error" not in errors
    assert code in (0, 130), errors
    if code == 130:
        assert errors.splitlines()[-1] == "clbvh: interrupted"
        assert output == "" or name in ("devices", "doctor", "fetch")
    assert place.leftovers() == []
    assert {path.name for path in place.output.iterdir()} <= {"scene.toml", "a.png", "a.npz"}
    return code == 130


@pytest.mark.parametrize("name", COMMANDS)
def test_ctrl_c_at_any_moment_leaves_nothing(place, name):
    words = COMMANDS[name]
    place.run(*words)
    usual_s = place.time(*words)
    moments = random.Random(f"Ctrl-C, {name}")
    count = sum(
        is_clean(place, place.signal_at(moments.uniform(0, _BEYOND * usual_s), signal.SIGINT, *words), name)
        for _ in range(MOMENTS)
    )
    print(f"{name}: {count} of {MOMENTS} interrupted, usual time {usual_s:.2f} s")
    assert count > 0
