"""A forked child of a process that has used OpenCL: one clear error at once, never a hang, and the parent goes on."""

import json
import subprocess
import sys

import pytest

from .forking import REFUSED

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks, and reads exit codes of Linux")

OPENCL = "DeviceError: this process was forked from one that had already used OpenCL, which works only in that one: "
NEEDS_THE_DEVICE = (
    "query", "query of a closed tracer", "query of few rays", "points", "update", "set_transforms", "set_vertices",
    "own tracer", "times", "devices", "render", "renderer", "trimesh", "sys.exit",
)  # fmt: skip


@pytest.fixture(scope="module")
def children():
    """How each child of `forking.py` ended, by its name."""
    script = [sys.executable, "-m", "tests.processes.forking"]
    ran = subprocess.run(script, capture_output=True, text=True, timeout=300, check=True)
    return json.loads(ran.stdout)


def test_what_needs_the_device_is_refused_in_one_line(children):
    for child in NEEDS_THE_DEVICE:
        outcome = children[child]
        assert outcome.startswith(OPENCL), (child, outcome)
        assert "'spawn'" in outcome, child
        assert "\n" not in outcome, child
    assert children["pool"].startswith("PoolError: the pool belongs to the process that this one was forked from")


def test_a_query_that_is_running_is_refused_and_its_parent_goes_on(children):
    assert children["in a query"] == [children["parent"][0], REFUSED]


def test_it_is_refused_even_where_threads_of_the_parent_hold_locks(children):
    (outcome,) = children["busy"]
    assert outcome.startswith(OPENCL)
    assert children["busy, close"] == ["null"]


def test_closing_and_forgetting_change_nothing(children):
    assert {children[child] for child in ("close", "forget", "forget, then sys.exit")} == {"null"}
    assert children["multiprocessing"] == 0
    before, after = children["parent of a scene"]
    assert before == after > 0
    hits, nodes = children["parent"]
    assert hits > 0
    assert nodes > 0


def test_what_needs_no_device_goes_on(children):
    assert json.loads(children["before the first use"]) == children["parent"][0]
    assert json.loads(children["host"]) == [30_000, True, [3, 6, 9]]
    hits, is_encoded = json.loads(children["picture of before"])
    assert hits > 0
    assert is_encoded
