"""SIGKILL of a command: no process stays, and the next run is right."""

from __future__ import annotations

import random
import time

import pytest

from ..profiles import is_long
from .place import Place, scene_in
from .sessions import list_session, wait_until

RENDER = ("render", "scene.toml", "-o", "a.png")
MOMENTS = 40 if is_long() else 1

# What a killed command has started, such as a linker, ends within this time.
PATIENCE_S = 20


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return scene_in(Place(tmp_path_factory.mktemp("k")))


@pytest.fixture(scope="module")
def usual_s(place):
    place.run(*RENDER)
    return place.time(*RENDER)


def test_a_killed_command_leaves_no_process_and_stops_no_later_run(place, usual_s):
    moments = random.Random("SIGKILL of a command")
    for _ in range(MOMENTS):
        process = place.start(*RENDER)
        time.sleep(moments.uniform(0, usual_s))
        process.kill()
        process.communicate()
        assert wait_until(lambda leader=process.pid: not list_session(leader), PATIENCE_S)
        code, _, errors = place.run(*RENDER)
        assert (code, errors) == (0, "")
