"""Ctrl-C and SIGTERM in each part of a turntable: no half animation, no ffmpeg that is left."""

from __future__ import annotations

import signal
import time

import pytest

from .place import Place, scene_in
from .sessions import list_session, wait_until
from .test_interrupted_commands import COMPILERS_LAST_WORD

# More frames than are done before the signal comes.
FRAMES = 2000


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = scene_in(Place(tmp_path_factory.mktemp("f")))
    code, _, errors = place.run("turntable", "scene.toml", "-o", "warm.gif", "--frames", 2)
    assert code == 0, errors
    (place.output / "warm.gif").unlink()
    return place


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_a_signal_between_frames_leaves_nothing(place, suffix, number):
    process = place.start("turntable", "scene.toml", "-o", f"a.{suffix}", "--frames", FRAMES)
    # An unfinished file is there once frames are drawn.
    assert wait_until(lambda: len(list(place.output.iterdir())) > 1, 60)
    time.sleep(0.3)
    assert process.poll() is None
    begin = time.perf_counter()
    process.send_signal(number)
    code, output, errors = place.finish(process)
    print(f"ended in {time.perf_counter() - begin:.2f} s")
    said = {signal.SIGINT: "clbvh: interrupted", signal.SIGTERM: "clbvh: terminated"}[number]
    assert (code, output) == (128 + number, "")
    assert [line for line in errors.splitlines() if line != COMPILERS_LAST_WORD] == [said]
    assert wait_until(lambda: not list_session(process.pid), 10), "processes are left"
    assert [path.name for path in place.output.iterdir()] == ["scene.toml"]
    assert place.leftovers() == []
