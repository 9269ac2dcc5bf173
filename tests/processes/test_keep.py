"""Ctrl-C, twice, and SIGTERM while samples are taken, with and without `--keep`."""

from __future__ import annotations

import json
import signal
import time

import pytest

from .place import Place, scene_in
from .test_interrupted_commands import COMPILERS_LAST_WORD

# More samples than are taken before the signal comes.
WORDS = ("render", "scene.toml", "-o", "a.png", "--samples", 10_000_000, "--json")

# From the call of `main`; by then samples are taken, unless the machine is busy.
MOMENT_S = 4.0


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = scene_in(Place(tmp_path_factory.mktemp("f")))
    code, _, errors = place.run("render", "scene.toml", "-o", "warm.png", "--samples", 2)
    assert code == 0, errors
    (place.output / "warm.png").unlink()
    return place


def files(place):
    return sorted(path.name for path in place.output.iterdir())


def said(errors):
    return [line for line in errors.splitlines() if line != COMPILERS_LAST_WORD]


def test_keep_writes_the_samples_so_far(place):
    code, output, errors = place.signal_at(MOMENT_S, signal.SIGINT, *WORDS, "--keep")
    assert (code, errors) == (0, "")
    assert 1 <= json.loads(output)["samples"] < 10_000_000
    assert files(place) == ["a.png", "scene.toml"]
    (place.output / "a.png").unlink()
    assert place.leftovers() == []


@pytest.mark.parametrize(
    ("number", "code", "line", "more"),
    [
        (signal.SIGINT, 130, "clbvh: interrupted", ()),
        (signal.SIGTERM, 143, "clbvh: terminated", ()),
        (signal.SIGTERM, 143, "clbvh: terminated", ("--keep",)),
    ],
    ids=["SIGINT", "SIGTERM", "SIGTERM-keep"],
)
def test_nothing_is_written_otherwise(place, number, code, line, more):
    outcome = place.signal_at(MOMENT_S, number, *WORDS, *more)
    assert (outcome[:2], said(outcome[2])) == ((code, ""), [line])
    assert files(place) == ["scene.toml"]
    assert place.leftovers() == []


def test_a_second_ctrl_c_ends_the_command(place):
    # A launch of this many pixels takes longer than the pause between the two signals.
    process = place.start(*WORDS, "--keep", "--width", 8000, "--height", 8000)
    time.sleep(MOMENT_S)
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    code, output, errors = place.finish(process)
    assert (code, output, said(errors)) == (130, "", ["clbvh: interrupted"]), errors
    assert files(place) == ["scene.toml"]
    assert place.leftovers() == []
