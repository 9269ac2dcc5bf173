"""A forked child of a process that has used OpenCL: one clear error at once, never a hang, and the parent goes on."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from .forking import REFUSED

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks, and reads exit codes of Linux")

OPENCL = "DeviceError: this process was forked from one that had already used OpenCL, which works only in that one: "
ENDS_ITSELF = [
    "query",
    "query of a closed tracer",
    "points",
    "query of few rays",
    "update",
    "set_transforms",
    "set_vertices",
    "own tracer",
    "times",
    "devices",
    "render",
    "renderer",
    "trimesh",
    "sys.exit",
]


@pytest.fixture(scope="module")
def children():
    """How each child of `forking.py` ended, by its name."""
    script = [sys.executable, "-m", "tests.processes.forking"]
    ran = subprocess.run(script, capture_output=True, text=True, timeout=300, check=True)
    return json.loads(ran.stdout)


def test_before_the_first_use_a_child_may_trace(children):
    assert json.loads(children["before the first use"]) == children["parent"][0]


@pytest.mark.parametrize("child", ENDS_ITSELF)
def test_what_needs_the_device_is_refused(children, child):
    assert children[child].startswith(OPENCL)
    assert "'spawn'" in children[child]
    assert "\n" not in children[child]


def test_a_query_that_is_running_is_refused(children):
    assert children["in a query"] == [children["parent"][0], REFUSED]


def test_it_is_refused_even_where_threads_of_the_parent_hold_locks(children):
    (outcome,) = children["busy"]
    assert outcome.startswith(OPENCL)
    assert children["busy, close"] == ["null"]


def test_the_pool_is_refused(children):
    assert children["pool"].startswith("PoolError: the pool belongs to the process that this one was forked from")


@pytest.mark.parametrize("child", ["close", "forget", "forget, then sys.exit"])
def test_closing_and_forgetting_change_nothing(children, child):
    assert children[child] == "null"


def test_a_child_of_multiprocessing_ends(children):
    assert children["multiprocessing"] == 0


def test_work_on_the_host_goes_on(children):
    assert json.loads(children["host"]) == [30_000, True, [3, 6, 9]]


def test_a_picture_is_read_and_encoded(children):
    hits, is_encoded = json.loads(children["picture of before"])
    assert hits > 0
    assert is_encoded


def test_the_parent_goes_on(children):
    before, after = children["parent of a scene"]
    assert before == after > 0
    hits, nodes = children["parent"]
    assert hits > 0
    assert nodes > 0
