"""SIGKILL of a command, of its workers and of its fork server, and a worker that hangs: no hang, and no litter."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest

from ..processes import list_session, wait_until
from ..profiles import is_long
from .command import Place, scene_in

WORKERS = ("render", "scene.toml", "-o", "a.png", "--workers", 2)
MOMENTS = 40 if is_long() else 1

# A killed coordinator's processes notice within this time.
PATIENCE_S = 20


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return scene_in(Place(tmp_path_factory.mktemp("k")))


@pytest.fixture(scope="module")
def usual_s(place):
    place.run(*WORKERS)
    return place.time(*WORKERS)


def name_of(process):
    """The kind of a process of a command: the command, its fork server (and workers), or the tracker of resources."""
    words = Path(f"/proc/{process}/cmdline").read_bytes().decode()
    return next((kind for kind in ("forkserver", "resource_tracker") if kind in words), "command")


def test_a_killed_command_ends_its_workers_and_the_next_run_removes_what_it_left(place, usual_s):
    moments = random.Random("SIGKILL of a command")
    for _ in range(MOMENTS):
        process = place.start(*WORKERS)
        time.sleep(moments.uniform(0, usual_s))
        process.kill()
        process.communicate()
        assert wait_until(lambda leader=process.pid: not list_session(leader), PATIENCE_S)
        code, _, errors = place.run(*WORKERS)
        assert (code, errors) == (0, "")
        assert place.leftovers() == []


def test_all_processes_killed_at_once_leave_only_what_the_next_run_removes(place, usual_s):
    moments = random.Random("SIGKILL of all")
    left = 0
    for _ in range(MOMENTS):
        process = place.start(*WORKERS)
        time.sleep(moments.uniform(0.3, 0.9) * usual_s)
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        left += len(place.leftovers())
        assert place.run(*WORKERS)[0] == 0
        assert place.leftovers() == []
    if is_long():
        assert left > 0, "no moment was one with temporary files"


@pytest.mark.parametrize("kind", ["worker", "forkserver"])
def test_a_killed_helper_is_an_error_or_does_not_matter(place, usual_s, kind):
    moments = random.Random(f"SIGKILL, {kind}")
    for _ in range(MOMENTS):
        process = place.start(*WORKERS)
        time.sleep(moments.uniform(0.2, 0.9) * usual_s)
        servers = [number for number in list_session(process.pid) if name_of(number) == "forkserver"]
        # The fork server is the first of its kind; workers are forked from it and keep its name.
        victims = servers[:1] if kind == "forkserver" else servers[1:2]
        for number in victims:
            os.kill(number, signal.SIGKILL)
        code, _, errors = place.finish(process)
        assert code in (0, 1), errors
        if code == 1:
            assert errors.startswith("clbvh: ")
            assert "worker" in errors
        assert "Traceback" not in errors
        assert wait_until(lambda leader=process.pid: not list_session(leader), PATIENCE_S)
        assert place.leftovers() == []
