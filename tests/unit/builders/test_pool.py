"""Worker processes: reuse, failure and death; what must be gone in the end, and what a script needs not do."""

from __future__ import annotations

import gc
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from clbvh import SubtreePool, build, validate_tree
from clbvh.builders.processes.pool import open_executor
from clbvh.builders.sah import build_sah as sah_module
from clbvh.errors import ConfigError, PoolError
from clbvh.support.host_threads import HostThreads, usable_cores

from ...processes import list_session, start_script, wait_until
from ...soup import make_soup

# Far above what closing a pool may take, far below the steps that are cut short.
SOON_S = 15.0
LONG_S = 60.0


def fail(arrays, word):
    raise ValueError(f"the word is {word}")


def leave(arrays, code):
    sys.exit(code)


def sleep_or_die(arrays, seconds):
    if seconds is None:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(seconds)


def run(pool, step, tasks):
    with open_executor(pool) as executor:
        return executor.map(step, tasks)


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
    for process in processes:
        assert process.exitcode is not None


def test_a_pool_serves_many_builds_and_leaves_no_file_open(pool):
    def count_open_files():
        return len(list(Path("/proc/self/fd").iterdir()))

    build(make_soup(100, seed=0), pool=pool, task_threshold=10)
    open_before = count_open_files()
    for seed in range(10):
        bvh = build(make_soup(100 + seed, seed), pool=pool, task_threshold=10)
        validate_tree(bvh)
        del bvh
    assert count_open_files() == open_before


def test_builds_of_two_threads_take_turns(pool):
    meshes = [make_soup(3000, seed=seed) for seed in range(4)]
    with HostThreads(4) as threads:
        trees = threads.run(lambda mesh: build(mesh, pool=pool, task_threshold=100), [(mesh,) for mesh in meshes])
    for mesh, tree in zip(meshes, trees, strict=True):
        assert tree.nodes.tobytes() == build(mesh).nodes.tobytes()


def test_a_tree_is_not_touched_by_the_next_build(pool):
    bvh = build(make_soup(2000, seed=1), pool=pool, task_threshold=100)
    before = bvh.nodes.tobytes(), bvh.prim_ids.tobytes()
    build(make_soup(2000, seed=2), pool=pool, task_threshold=100)
    assert (bvh.nodes.tobytes(), bvh.prim_ids.tobytes()) == before


def test_a_pool_says_what_it_is(pool):
    assert repr(pool) == "SubtreePool(workers=2)"


def test_the_default_is_every_usable_processor():
    assert usable_cores() == len(os.sched_getaffinity(0))
    with SubtreePool() as pool:
        assert pool.workers == usable_cores()


@pytest.mark.parametrize("workers", [0, -1, 1025, 10**9])
def test_too_few_and_too_many_workers_are_refused(workers):
    with pytest.raises(ConfigError, match=f"workers must be 1 to 1024, not {workers}"):
        SubtreePool(workers=workers)


@pytest.mark.parametrize("workers", [2.5, "2", True])
def test_a_number_of_workers_is_a_whole_number(workers):
    with pytest.raises(ConfigError, match="workers must be a whole number"):
        SubtreePool(workers=workers)


def test_a_closed_pool_refuses_and_may_be_closed_again():
    pool = SubtreePool(workers=1)
    pool.close()
    pool.close()
    assert repr(pool) == "SubtreePool(workers=1, closed)"
    for use in (pool.wait_ready, lambda: build(make_soup(100, seed=0), pool=pool, task_threshold=10)):
        with pytest.raises(PoolError, match="the pool is closed: create another one"):
            use()


def test_closing_ends_the_processes():
    with SubtreePool(workers=2) as pool:
        pool.wait_ready()
        processes = processes_of(pool)
        assert [process.exitcode for process in processes] == [None, None]
    assert [process.exitcode for process in processes] == [0, 0]


def test_a_pool_that_is_dropped_ends_its_workers_and_the_next_one_starts():
    pool = SubtreePool(workers=1)
    pool.wait_ready()
    process = processes_of(pool)[0]
    del pool
    gc.collect()
    assert process.exitcode == 0
    with SubtreePool(workers=1) as another:
        another.wait_ready()


def test_an_error_in_the_block_closes_the_pool_and_passes():
    with pytest.raises(ZeroDivisionError), SubtreePool(workers=1) as pool:  # noqa: PT012 - the block is what is tested
        pool.wait_ready()
        processes = processes_of(pool)
        raise ZeroDivisionError
    assert processes[0].exitcode == 0


def test_a_step_that_raises_arrives_with_its_traceback(doomed):
    with pytest.raises(
        PoolError, match=r"(?s)worker \d failed:.*in fail\n.*ValueError: the word is swordfish"
    ) as caught:
        run(doomed, fail, [("swordfish",)] * 4)
    assert str(caught.value).count("Traceback") == 1
    with pytest.raises(PoolError, match="closed"):
        doomed.wait_ready()


def test_a_killed_worker_is_an_error_at_once_though_another_is_busy(doomed):
    begin = time.perf_counter()
    with pytest.raises(PoolError, match=r"worker 1 died \(exit code -9\)"):
        run(doomed, sleep_or_die, [(LONG_S,), (None,)])
    assert time.perf_counter() - begin < SOON_S


def test_a_worker_that_exits_is_an_error_with_its_code(doomed):
    with pytest.raises(PoolError, match=r"worker 0 died \(exit code 3\)"):
        run(doomed, leave, [(3,)])


def test_a_worker_killed_from_outside_during_a_build_is_an_error(doomed, monkeypatch):
    real = sah_module.split_top

    def kill_then_split(*arguments):
        processes_of(doomed)[0].kill()
        real(*arguments)

    monkeypatch.setattr(sah_module, "split_top", kill_then_split)
    begin = time.perf_counter()
    with pytest.raises(PoolError, match="worker 0 died"):
        build(make_soup(2000, seed=1), pool=doomed, task_threshold=10)
    assert time.perf_counter() - begin < SOON_S


# Builds until it is stopped. Where the tests run in the background, their children ignore Ctrl-C unless told so.
BUSY_SCRIPT = """
import signal
import clbvh
signal.signal(signal.SIGINT, signal.default_int_handler)
from clbvh.geometry.shapes.make_shape import make_shape
if __name__ == "__main__":
    mesh = make_shape("icosphere", triangles=60_000)
    with clbvh.SubtreePool(workers=2) as pool:
        clbvh.build(mesh, pool=pool)
        print("building", flush=True)
        while True:
            clbvh.build(mesh, pool=pool)
"""

FORGETFUL_SCRIPT = """
import clbvh
if __name__ == "__main__":
    pool = clbvh.SubtreePool(workers=2)
    mesh = clbvh.make_shape("icosphere", triangles=1000)
    print(clbvh.build(mesh, pool=pool, task_threshold=100).node_count > 100)
"""


@pytest.fixture
def script(short_path):
    """A function that starts a script in a session of its own, with the folder that must be empty in the end."""
    folder = short_path / "temporary"
    folder.mkdir()
    started = []

    def start(text):
        path = short_path / "script.py"
        path.write_text(text)
        started.append(start_script([path], folder))
        return started[-1], folder

    yield start
    for process in started:
        for left_over in list_session(process.pid):
            os.kill(left_over, signal.SIGKILL)
        process.communicate()


def assert_nothing_left(process, folder):
    assert wait_until(lambda: not list_session(process.pid)), f"processes left: {list_session(process.pid)}"
    assert wait_until(lambda: not list(folder.iterdir())), f"files left: {list(folder.iterdir())}"


def test_ctrl_c_during_a_build_ends_everything(script):
    process, folder = script(BUSY_SCRIPT)
    assert process.stdout.readline() == "building\n"
    begin = time.perf_counter()
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=SOON_S)
    assert time.perf_counter() - begin < SOON_S
    assert process.returncode == -signal.SIGINT
    # One traceback: the coordinator's, with those of the exceptions that it was handling. Workers are quiet.
    assert errors.count("Traceback") == 1 + errors.count("During handling of the above exception")
    assert errors.rstrip().endswith("KeyboardInterrupt")
    assert_nothing_left(process, folder)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_coordinator_that_is_killed_leaves_nothing(script, number):
    process, folder = script(BUSY_SCRIPT)
    assert process.stdout.readline() == "building\n"
    assert len(list_session(process.pid)) >= 3
    process.send_signal(number)
    _, errors = process.communicate(timeout=SOON_S)
    assert process.returncode == -number
    assert_nothing_left(process, folder)
    assert "Traceback" not in errors


def test_a_pool_that_nobody_closes_ends_with_the_script(script):
    process, folder = script(FORGETFUL_SCRIPT)
    assert process.communicate(timeout=SOON_S) == ("True\n", "")
    assert process.returncode == 0
    assert_nothing_left(process, folder)
