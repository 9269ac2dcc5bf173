"""What experiments measure with: engines in processes of their own, `perf stat`, and the counted work of the ladder."""

from __future__ import annotations

import multiprocessing
import os
import sys

import numpy as np
import pytest

from clbvh import BuildOptions, Mesh
from clbvh.study.engines import EngineError, Rival, open_engine
from clbvh.study.experiments.peers import QUERIES
from clbvh.study.ladder_work import count_ladder_work
from clbvh.study.machine import count_build, find_counter_problem

RAY_COUNT = 64
RAYS = ("coherent", "shuffled", "scattered")


@pytest.mark.usefixtures("_opened_device")
def test_this_library_in_a_process_of_its_own(tmp_path, mesh):
    origins = np.tile([[0.0, 0.0, 9.0]], (RAY_COUNT, 1))
    directions = np.random.default_rng(0).normal(size=(RAY_COUNT, 3)) * [0.1, 0.1, 0.0] - [0, 0, 1]
    arrays = {"vertices": mesh.vertices, "faces": mesh.faces, "points": origins[None]}
    for name, array in {**arrays, **dict.fromkeys(RAYS, np.stack((origins, directions)))}.items():
        np.save(tmp_path / f"{name}.npy", array)
    with Rival(open_engine, "clbvh", str(tmp_path)) as engine:
        for query in QUERIES:
            assert engine.measure(query).wall_ms > 0
        (_, closest), (_, every) = (engine.measure(query).result for query in ("coherent", "all"))
        assert 0 < closest <= every
        # It survives a question that it does not understand.
        with pytest.raises(EngineError, match="the engine fails: KeyError"):
            engine.measure("no such query")
        assert engine.measure("any").result == (RAY_COUNT, closest)
        engine._process.kill()
        with pytest.raises(EngineError, match="the engine's process died"):
            engine.measure("any")
    assert engine._process not in multiprocessing.active_children()


@pytest.mark.skipif(sys.platform == "win32", reason="perf is Linux's")
def test_perf_is_read_without_pythons_start(monkeypatch, tmp_path):
    perf = tmp_path / "perf"
    # Counts as many instructions as the last word of the command says, for each build and once for the start.
    perf.write_text("""#!/bin/sh
for last; do :; done
case "$last" in [0-9]*) builds=$last;; *) builds=0;; esac
echo "$((1000 + 500 * builds)),,instructions:u,1,100.00,," >&2
echo "$((10 + 7 * builds)),,cache-misses,1,100.00,," >&2
""")
    perf.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
    find_counter_problem.cache_clear()
    assert count_build("knot-1000", "flat") == {"instructions": 500, "cache_misses": 7}
    find_counter_problem.cache_clear()


def test_the_work_of_two_triangles_by_hand():
    # Along x, in the wrong order.
    corners = np.array([[[5, 0, 0], [6, 0, 0], [5, 1, 0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]]], float)
    pair = Mesh.from_arrays(corners.reshape(-1, 3), np.arange(6).reshape(2, 3))
    work, copying, binned = (
        count_ladder_work(pair, name, BuildOptions(leaf_size=1)) for name in ("range", "naive", "flat")
    )
    # One comparison; both numbers change places, and leaves write theirs; three nodes from the heap, no lists.
    assert (work.comparisons, work.bin_lookups, work.moves, work.allocations) == (1, 0, 2 + 2, 3)
    # The root bounds both, each leaf one; each bound asks for a box and three coordinates; a comparison for two more.
    assert work.boxes == 4 * (2 + 1 + 1) + 2
    # Lists: two more allocations, and both numbers are copied.
    assert (copying.allocations, copying.moves) == (5, work.moves + 2)
    # Each is looked up once to count and once to part them.
    assert (binned.comparisons, binned.bin_lookups, binned.allocations, binned.boxes) == (0, 4, 0, 2)
