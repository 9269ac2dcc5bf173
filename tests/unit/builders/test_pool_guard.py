"""Scripts that create a pool: with a guard, without one, and where there is no script to import."""

from __future__ import annotations

import os
import signal
import time

import pytest

from ...processes import list_session, start_script

WORKERS = 2
PATIENCE_S = 60

# The coordinator, the fork server, multiprocessing's resource tracker, and the workers.
MOST_PROCESSES = 3 + WORKERS

# Each process that runs the script leaves a line.
HEAD = """
import os
with open({log!r}, "a") as log:
    print(os.getpid(), file=log)
import numpy as np
import clbvh
vertices = np.random.default_rng(0).random((3 * {count}, 3))
mesh = clbvh.Mesh.from_arrays(vertices, np.arange(3 * {count}).reshape(-1, 3))
"""

PLAIN = """
pool = clbvh.SubtreePool(workers={workers})
print(clbvh.build(mesh, pool=pool, task_threshold=100).node_count)
pool.close()
"""

GUARDED = """
if __name__ == "__main__":
    with clbvh.SubtreePool(workers={workers}) as pool:
        print(clbvh.build(mesh, pool=pool, task_threshold=100).node_count)
"""

AFTER_OPENCL = """
if __name__ == "__main__":
    tracer = clbvh.Tracer(clbvh.build(mesh))
    before = tracer.closest_hit([[0.5, 0.5, -1.0]], [[0.0, 0.0, 1.0]]).t
    with clbvh.SubtreePool(workers={workers}) as pool:
        bvh = clbvh.build(mesh, pool=pool, task_threshold=100)
    with clbvh.Tracer(bvh) as again:
        assert (again.closest_hit([[0.5, 0.5, -1.0]], [[0.0, 0.0, 1.0]]).t == before).all()
    tracer.close()
    print(bvh.node_count)
"""


@pytest.fixture
def run(short_path):
    """A function that runs a script and returns (exit code, output, errors, all process ids, lines of the log)."""
    started = []

    def run_script(body, how="file", count=1000):
        log = short_path / "log"
        text = HEAD.format(log=str(log), count=count) + body.format(workers=WORKERS)
        path = short_path / "script.py"
        path.write_text(text)
        arguments = {"file": [path], "-c": ["-c", text], "stdin": []}[how]
        folder = short_path / "temporary"
        folder.mkdir()
        with path.open() as standard_input:
            process = start_script(arguments, folder, stdin=standard_input)
        started.append(process)
        seen = set()
        while process.poll() is None:
            seen.update(list_session(process.pid))
            time.sleep(0.01)
        output, errors = process.communicate(timeout=PATIENCE_S)
        return process.returncode, output, errors, seen, log.read_text().splitlines()

    yield run_script
    for process in started:
        for left_over in list_session(process.pid):
            os.kill(left_over, signal.SIGKILL)


@pytest.mark.parametrize("count", [1000, 30_000])
def test_without_a_guard_there_is_one_clear_error_and_no_storm(run, count):
    code, output, errors, seen, log = run(PLAIN, count=count)
    assert code == 1
    assert output == ""
    assert errors.count("Traceback") == 1
    last = errors.rstrip().splitlines()[-1]
    assert last.startswith("clbvh.errors.PoolError: this script creates a SubtreePool while its workers import it")
    assert last.endswith('if __name__ == "__main__":')
    assert len(seen) <= MOST_PROCESSES
    assert 2 <= len(log) <= 1 + WORKERS


def test_a_guarded_script_works(run):
    code, output, errors, _, log = run(GUARDED)
    assert (code, errors) == (0, "")
    assert int(output) > 100
    assert len(log) == 1 + WORKERS


@pytest.mark.parametrize("how", ["-c", "stdin"])
def test_where_there_is_no_script_to_import_no_guard_is_needed(run, how):
    code, output, errors, _, log = run(PLAIN, how)
    assert (code, errors) == (0, "")
    assert int(output) > 100
    assert len(log) == 1


@pytest.mark.usefixtures("session")  # skips where there is no device
def test_a_pool_created_after_opencl_started_works(run):
    code, output, errors, _, _ = run(AFTER_OPENCL)
    assert (code, errors) == (0, "")
    assert int(output) > 100
