"""Workers and what they share: steps on arrays, reuse, failure and death of processes, and nothing left in the end."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from clbvh import ConfigError, PoolError, SubtreePool, build
from clbvh.builders.executor import ThreadExecutor
from clbvh.builders.processes import shared_memory
from clbvh.builders.processes.pool import open_executor
from clbvh.builders.processes.shared_memory import SharedArray
from clbvh.builders.sah import build_sah as sah_module
from clbvh.support.host_threads import HostThreads

from ...processes.sessions import list_session, start_script, wait_until
from ...soup import make_soup

# Far above what closing a pool may take, far below the steps that are cut short.
SOON_S = 15.0
LONG_S = 60.0


def add(arrays, name, number):
    arrays[name] += number
    return number


def total(arrays, name):
    return float(arrays[name].sum())


def end(arrays, how):
    if how == "raise":
        raise ValueError("the word is swordfish")
    if how == "exit":
        sys.exit(3)
    if how == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(LONG_S)


def processes_of(pool):
    return [worker.process for worker in pool._workers]


@pytest.fixture(scope="module")
def pool():
    """Two workers for tests that leave them as they were."""
    with SubtreePool(workers=2) as pool:
        yield pool


@pytest.fixture
def doomed():
    """Two workers for tests that end them; none may be left."""
    with SubtreePool(workers=2) as pool:
        pool.wait_ready()
        processes = processes_of(pool)
        yield pool
    assert None not in [process.exitcode for process in processes]


@pytest.fixture(params=["one thread", "threads", "processes"])
def executor(request, pool):
    threads = 1 if request.param == "one thread" else 2
    with open_executor(pool) if request.param == "processes" else ThreadExecutor(threads) as executor:
        yield executor


def test_a_step_sees_and_changes_the_arrays(executor):
    created = executor.create("created", (3,), np.int64)
    created[:] = 0
    read_only = np.full(5, 2.0)
    read_only.flags.writeable = False
    executor.share("shared", read_only)
    assert executor.map(add, [("created", number) for number in range(300)]) == list(range(300))
    assert executor.map(add, []) == []
    assert executor.map(total, [("created",), ("shared",)]) == [3 * 299 * 150, 10]
    assert created.tolist() == [299 * 150] * 3
    assert set(map(tuple, executor.run_on_each(sorted))) == {("created", "shared")}
    executor.discard("shared")
    assert executor.map(sorted, [()]) == [["created"]]


def test_shared_memory_leaves_no_file_and_too_little_of_it_is_refused(monkeypatch, tmp_path):
    shared = SharedArray((1000,), "u1")
    assert "memfd" in os.readlink(shared.handle.path)  # noqa: PTH115 - the link's text
    shared.close()
    with pytest.raises(PoolError, match=r"needs 1,000,000,000 MB .* or build without a pool"):
        SharedArray((10**15,), "u1")
    # As on systems without anonymous files.
    monkeypatch.setattr(shared_memory, "_HAS_ANONYMOUS_FILES", False)
    monkeypatch.setattr(shared_memory.tempfile, "tempdir", str(tmp_path))
    shared = SharedArray((1000,), "u1")
    shared.handle.attach()[17] = 5
    assert shared.array[17] == 5
    shared.close()
    assert list(tmp_path.iterdir()) == []


def test_a_pool_serves_the_builds_of_many_threads_and_leaves_no_file_open(pool):
    def count_open_files():
        return len(list(Path("/proc/self/fd").iterdir()))

    meshes = [make_soup(1000 + seed, seed=seed) for seed in range(8)]
    build(meshes[-1], pool=pool, task_threshold=100)
    open_before = count_open_files()
    with HostThreads(4) as threads:
        trees = threads.run(lambda mesh: build(mesh, pool=pool, task_threshold=100), [(mesh,) for mesh in meshes])
    for mesh, tree in zip(meshes, trees, strict=True):
        assert tree.nodes.tobytes() == build(mesh).nodes.tobytes()
    del tree, trees
    assert count_open_files() == open_before


def test_a_closed_pool_has_ended_its_processes_refuses_and_may_be_closed_again():
    with SubtreePool() as pool:
        pool.wait_ready()
        processes = processes_of(pool)
        assert [process.exitcode for process in processes] == [None] * len(os.sched_getaffinity(0))
    assert {process.exitcode for process in processes} == {0}
    pool.close()
    for use in (pool.wait_ready, lambda: build(make_soup(100, seed=0), pool=pool, task_threshold=10)):
        with pytest.raises(PoolError, match="the pool is closed: create another one"):
            use()
    for workers in (0, -1, 1025, 2.5, "2", True):
        with pytest.raises(
            ConfigError, match=rf"workers must be a whole number from 1 to 1,024, or None, not '?{workers}"
        ):
            SubtreePool(workers=workers)


@pytest.mark.parametrize(
    ("ways", "message"),
    [
        (["sleep", "die"], r"worker 1 died \(exit code -9\)"),
        (["exit"], r"worker 0 died \(exit code 3\)"),
        (["raise"] * 4, r"(?s)^worker \d failed:.*in end\n.*ValueError: the word is swordfish"),
    ],
)
def test_a_worker_that_fails_is_an_error_at_once_though_another_is_busy(doomed, ways, message):
    begin = time.perf_counter()
    with pytest.raises(PoolError, match=message) as caught, open_executor(doomed) as executor:
        executor.map(end, [(how,) for how in ways])
    assert time.perf_counter() - begin < SOON_S
    assert str(caught.value).count("Traceback") == ("raise" in ways)
    with pytest.raises(PoolError, match="closed"):
        doomed.wait_ready()


def test_a_worker_killed_from_outside_during_a_build_is_an_error_and_a_new_pool_builds(doomed, monkeypatch):
    real, mesh = sah_module.split_top, make_soup(2000, seed=1)

    def kill_then_split(*arguments):
        processes_of(doomed)[0].kill()
        real(*arguments)

    monkeypatch.setattr(sah_module, "split_top", kill_then_split)
    with pytest.raises(PoolError, match="worker 0 died"):
        build(mesh, pool=doomed, task_threshold=10)
    monkeypatch.undo()
    with SubtreePool(workers=2) as another:
        assert build(mesh, pool=another, task_threshold=10).nodes.tobytes() == build(mesh).nodes.tobytes()


# Builds until it is stopped. Where the tests run in the background, their children ignore Ctrl-C unless told so.
BUSY_SCRIPT = """
import signal
import clbvh
signal.signal(signal.SIGINT, signal.default_int_handler)
if __name__ == "__main__":
    mesh = clbvh.make_shape("icosphere", triangles=60_000)
    with clbvh.SubtreePool(workers=2) as pool:
        clbvh.build(mesh, pool=pool)
        print("building", flush=True)
        while True:
            clbvh.build(mesh, pool=pool)
"""


@pytest.fixture
def start(short_path):
    """A function that starts a script in a session of its own; no process and no file of it may be left."""
    folder, started = short_path / "temporary", []
    folder.mkdir()

    def start(text):
        path = short_path / "script.py"
        path.write_text(text)
        started.append(start_script([path], folder))
        return started[-1]

    yield start
    (process,) = started
    is_empty = wait_until(lambda: not [*list_session(process.pid), *folder.iterdir()])
    left_over = [*list_session(process.pid), *folder.iterdir()]
    for left in list_session(process.pid):
        os.kill(left, signal.SIGKILL)
    process.communicate()
    assert is_empty, left_over


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL, signal.SIGTERM])
def test_a_coordinator_that_is_stopped_during_a_build_leaves_nothing(start, number):
    process = start(BUSY_SCRIPT)
    assert process.stdout.readline() == "building\n"
    assert len(list_session(process.pid)) >= 3
    if number == signal.SIGINT:  # Ctrl-C reaches the workers, too
        os.killpg(process.pid, number)
    else:
        process.send_signal(number)
    _, errors = process.communicate(timeout=SOON_S)
    assert process.returncode == -number
    # One traceback: the coordinator's, with those of the exceptions that it was handling. Workers are quiet.
    tracebacks = errors.count("Traceback") - errors.count("During handling of the above exception")
    assert tracebacks == (number == signal.SIGINT)
    assert errors.rstrip().endswith("KeyboardInterrupt" * tracebacks)


def test_a_pool_that_nobody_closes_ends_with_the_script(start):
    build_once = "clbvh.build(clbvh.make_shape('icosphere', triangles=1000), pool=pool, task_threshold=100)"
    process = start(f"import clbvh\nif __name__ == '__main__':\n    pool = clbvh.SubtreePool(2)\n    {build_once}\n")
    assert process.communicate(timeout=SOON_S) == ("", "")
    assert process.returncode == 0
