"""SIGKILL of a command: no process stays, and the next run removes what was left."""

from __future__ import annotations

import os
import random
import signal
import time

import pytest

from ..processes import list_session, wait_until
from ..profiles import is_long
from .command import Place, scene_in

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


def test_a_killed_command_ends_its_processes_and_the_next_run_removes_what_it_left(place, usual_s):
    moments = random.Random("SIGKILL of a command")
    for _ in range(MOMENTS):
        process = place.start(*RENDER)
        time.sleep(moments.uniform(0, usual_s))
        process.kill()
        process.communicate()
        assert wait_until(lambda leader=process.pid: not list_session(leader), PATIENCE_S)
        code, _, errors = place.run(*RENDER)
        assert (code, errors) == (0, "")
        assert place.leftovers() == []


def test_all_processes_killed_at_once_leave_only_what_the_next_run_removes(place, usual_s):
    moments = random.Random("SIGKILL of all")
    left = 0
    for _ in range(MOMENTS):
        process = place.start(*RENDER)
        time.sleep(moments.uniform(0.3, 0.9) * usual_s)
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        left += len(place.leftovers())
        assert place.run(*RENDER)[0] == 0
        assert place.leftovers() == []
    if is_long():
        assert left > 0, "no moment was one with temporary files"
