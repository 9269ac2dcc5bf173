"""Builds that crashed, took long, left a pool unusable, or gave other bytes by the number of workers."""

import os
import signal
import sys
import time
import types

import numpy as np
import pytest

from clbvh import Mesh, PoolError, SubtreePool, Tracer, build, make_shape, validate_tree
from clbvh.builders.processes import pool as pool_module
from clbvh.builders.processes.pool import open_executor

from ..cli.command import run_clbvh
from ..soup import make_soup


def test_the_table_of_a_picture_without_a_tree_was_a_traceback(tmp_path):
    make_shape("icosphere", triangles=80).save(tmp_path / "ball.ply")
    answer = run_clbvh("render", tmp_path / "ball.ply", "-o", tmp_path / "ball.png", "--builder", "brute")
    assert (answer.returncode, "layout brute" in answer.stdout) == (0, True)


@pytest.mark.parametrize("failing", [0, 1])
def test_after_a_failed_build_workers_took_the_next_ones_arrays_for_those_they_held(monkeypatch, failing):
    create, sizes = pool_module.SharedArray, []

    def refuse_one_array(shape, dtype):
        sizes.append(shape)
        if len(sizes) == 1 + failing:
            raise PoolError("no memory left")
        return create(shape, dtype)

    with SubtreePool(workers=2) as pool:
        build(make_soup(500, seed=0), pool=pool, task_threshold=7)
        with monkeypatch.context() as patch:
            patch.setattr(pool_module, "SharedArray", refuse_one_array)
            with pytest.raises(PoolError, match="no memory left"):
                build(make_soup(1000, seed=1), pool=pool, task_threshold=7)
        validate_tree(build(make_soup(1000, seed=2), pool=pool, task_threshold=7))


def test_a_worker_that_died_between_builds_was_a_broken_pipe():
    with SubtreePool(workers=2) as pool:
        pool.wait_ready()
        process = pool._workers[1].process
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        with pytest.raises(PoolError, match=r"worker 1 died \(exit code -9\)"):
            pool.wait_ready()


def return_a_function(arrays):
    return lambda: None


def test_a_step_that_a_worker_cannot_import_and_a_result_that_cannot_be_sent_killed_it(monkeypatch):
    module = types.ModuleType("module_of_the_coordinator")
    exec("def step(arrays): return 1", module.__dict__)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    for step, message in (
        (module.step, "No module named 'module_of_the_coordinator'"),
        (return_a_function, r"(?s)worker 0 failed.*pickle"),
    ):
        with SubtreePool(workers=1) as pool, pytest.raises(PoolError, match=message), open_executor(pool) as executor:
            executor.map(step, [()])


def test_bundling_many_small_ranges_took_quadratic_time():
    mesh = make_soup(20_000, seed=1)
    build(mesh, workers=1, task_threshold=5000)  # the compiled code is loaded
    begin = time.process_time()
    build(mesh, workers=1, task_threshold=1)
    # 0.1 s on a 2-core x86-64 server; 1e8 looks at ranges would take longer than this.
    assert time.process_time() - begin < 3


@pytest.mark.parametrize("scale", [8e37, 1e150])
def test_a_mesh_as_wide_as_float32_made_bins_nan_and_the_process_crash(scale):
    vertices = np.random.default_rng(0).uniform(-1, 1, (3000, 3)) * scale
    bvh = build(Mesh.from_arrays(vertices, np.arange(3000).reshape(-1, 3)))
    with Tracer(bvh) as tracer:
        assert tracer.any_hit(vertices[:100] * 2, -vertices[:100]).mean() > 0.5
