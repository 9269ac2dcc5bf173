"""A forked child: on the host it works like its parent; where that has used OpenCL, one clear error at once.

Never a hang, and the parent goes on.
"""

import json
import os
import subprocess
import sys

import pytest

from .forking import REFUSED

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks, and reads exit codes of Linux")

OPENCL = "DeviceError: this process was forked from one that had already used OpenCL, which works only in that one: "
NEEDS_THE_DEVICE = (
    "query", "query of a closed tracer", "query of few rays", "points", "update", "set_transforms", "set_vertices",
    "own tracer", "times", "render", "renderer", "trimesh", "sys.exit", "fast build",
    "array", "array of rays",
)  # fmt: skip


def fork(device):
    """Return how each child of `forking.py` ended, by its name."""
    script, environment = [sys.executable, "-m", "tests.processes.forking"], {**os.environ, "CLBVH_DEVICE": device}
    ran = subprocess.run(script, capture_output=True, text=True, timeout=300, check=True, env=environment)
    return json.loads(ran.stdout)


@pytest.fixture(scope="module")
def children():
    """Those of a process that uses OpenCL."""
    return fork("pocl")


@pytest.fixture(scope="module")
def host_children():
    """Those of a process that uses the host alone."""
    return fork("host")


def test_a_child_gets_on_the_host_what_its_parent_gets(host_children):
    assert {name: host_children[name] for name in host_children["expected"]} == host_children["expected"]
    assert host_children["query of a closed tracer"].startswith("QueryError: the tracer is closed")
    assert json.loads(host_children["times"])["kernel"] > 0
    assert json.loads(host_children["sys.exit"]) == host_children["parent"][0]


def test_parent_child_and_a_pool_cast_at_the_same_time_on_the_host(host_children):
    assert host_children["at once"] == [False, 0]
    assert host_children["multiprocessing pool"] == [False] * 4


def test_a_fork_in_a_query_goes_on_in_both_on_the_host(host_children):
    assert host_children["in a query"] == [host_children["parent"][0], 0]


def test_a_task_without_its_helpers_is_refused(host_children):
    assert host_children["in a task"] == [[1, 2, 3], REFUSED]


def test_threads_that_cast_at_the_fork_harm_no_child_on_the_host(host_children):
    assert host_children["busy"] == [json.dumps(host_children["parent"][0])]
    assert host_children["busy, close"] == ["null"]
    assert host_children["busy forks"] == [0]


def test_after_opencl_a_child_chooses_the_host(children):
    assert json.loads(children["devices"]) == ["host"]
    *of_host, pocl, gpu = json.loads(children["choices"])
    assert of_host == ["host"] * 4
    assert pocl == gpu
    assert f"DeviceError: {pocl}".startswith(OPENCL)


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


@pytest.mark.parametrize("device", ["children", "host_children"])
def test_closing_and_forgetting_change_nothing(device, request):
    children = request.getfixturevalue(device)
    assert {children[child] for child in ("close", "forget", "forget, then sys.exit")} == {"null"}
    assert children["multiprocessing"] == 0
    before, after = children["parent of a scene"]
    assert before == after > 0
    hits, nodes = children["parent"]
    assert hits > 0
    assert nodes > 0


@pytest.mark.parametrize("device", ["children", "host_children"])
def test_what_needs_no_device_goes_on(device, request):
    children = request.getfixturevalue(device)
    assert json.loads(children["before the first use"]) == children["parent"][0]
    assert json.loads(children["host"]) == [30_000, True, [3, 6, 9]]
    hits, is_encoded = json.loads(children["picture of before"])
    assert hits > 0
    assert is_encoded
