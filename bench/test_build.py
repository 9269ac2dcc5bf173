"""How long a tree takes, and how much memory."""

from __future__ import annotations

import statistics
import subprocess
import sys

import pytest

import clbvh
from clbvh.support.host_threads import usable_cores

from .paired import DEFAULT_RUNS, compare, measure_ms

# From the start of the interpreter's first statement to the first answer of a pool.
POOL_START = """
import time
begin = time.perf_counter()
from clbvh import SubtreePool
if __name__ == "__main__":
    with SubtreePool(2) as pool:
        pool.wait_ready()
        print((time.perf_counter() - begin) * 1e3)
"""

# Bytes per triangle at the worst moment of a build, in a process that has done nothing else. In one mapping of its own
# each array goes back to the system as soon as it is freed, so that the peak is the build's.
MEMORY = """
import os
os.environ["MALLOC_MMAP_THRESHOLD_"] = "1000000"
if __name__ == "__main__":
    import sys
    from pathlib import Path
    if len(sys.argv) == 1:
        os.execv(sys.executable, [sys.executable, __file__, "again"])
    import clbvh
    def status_bytes(name):
        (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name + ":"))
        return int(line.split()[1]) * 1024
    mesh = clbvh.make_shape("knot", triangles=1_000_000, seed=1)
    clbvh.build(clbvh.make_shape("knot", triangles=1000, seed=1))
    before = status_bytes("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")
    bvh = clbvh.build(mesh)
    beyond = status_bytes("VmHWM") - before - bvh.nodes.nbytes - bvh.prim_ids.nbytes
    print(beyond / mesh.face_count)
"""


def test_build_against_open3d(mesh, open3d):
    def build_peer() -> float:
        return measure_ms(open3d.build)

    for workers in (None, 1):
        name = f"build, {workers or usable_cores()} threads, Open3D"
        compare(name, lambda workers=workers: measure_ms(lambda: clbvh.build(mesh, workers=workers)), build_peer)
    bvh = clbvh.build(mesh)
    print(f"{bvh}, SAH cost {clbvh.sah_cost(bvh):.2f}, phases in ms: {bvh.timings_ms}")


def test_threads_against_one_and_against_processes(mesh):
    def build_by_threads() -> float:
        return measure_ms(lambda: clbvh.build(mesh, workers=2))

    with clbvh.SubtreePool(2) as pool:
        compare(
            "build, 2 threads, 2 processes", build_by_threads, lambda: measure_ms(lambda: clbvh.build(mesh, pool=pool))
        )
    ratio = compare(
        "build, 2 threads, 1 thread",
        build_by_threads,
        lambda: measure_ms(lambda: clbvh.build(mesh, workers=1)),
        runs=3 * DEFAULT_RUNS,
    )
    # Amdahl's law, 1 / speedup = serial + (1 - serial) / workers, solved for the serial part and put in again.
    serial = max(0.0, 2 * ratio - 1)
    predicted = ", ".join(f"{workers}: {1 / (serial + (1 - serial) / workers):.1f}" for workers in (4, 8, 16))
    print(f"{1 / ratio:.2f} times as fast; serial part {serial:.2f}, which allows for workers {predicted}")


@pytest.mark.parametrize("workers", [None, 1], ids=["all", "one"])
def test_fast_against_default(mesh, workers):
    compare(
        f"build, quality fast, {workers or usable_cores()} threads, default",
        lambda: measure_ms(lambda: clbvh.build(mesh, workers=workers, quality="fast")),
        lambda: measure_ms(lambda: clbvh.build(mesh, workers=workers)),
    )
    fast, default = clbvh.build(mesh, quality="fast"), clbvh.build(mesh)
    print(f"SAH cost {clbvh.sah_cost(fast):.2f} against {clbvh.sah_cost(default):.2f}, phases in ms: {fast.timings_ms}")


def test_ten_million_against_one():
    small, large = (clbvh.make_shape("knot", triangles=count, seed=1) for count in (1_000_000, 10_000_000))
    for workers in (1, usable_cores()):
        millions = [_median_of_builds(mesh, workers) for mesh in (small, large)]
        linear = millions[0] * large.face_count / small.face_count
        print(
            f"\n10 million, {workers} threads: {millions[1]:.0f} ms, {millions[1] / linear:.2f} of linear from a tenth"
        )


def test_memory_beyond_the_mesh_and_the_result(tmp_path):
    script = tmp_path / "memory.py"
    script.write_text(MEMORY)
    beyond = subprocess.run([sys.executable, script], check=True, capture_output=True, text=True).stdout
    print(f"\nbuild: {float(beyond):.0f} bytes per triangle beside the mesh and the result")


def test_start_of_a_pool():
    def start() -> float:
        return float(subprocess.run([sys.executable, "-c", POOL_START], check=True, capture_output=True).stdout)

    start()
    print(f"\nimport and start of 2 workers: {statistics.median(start() for _ in range(DEFAULT_RUNS)):.0f} ms")


def _median_of_builds(mesh, workers):
    return statistics.median(measure_ms(lambda: clbvh.build(mesh, workers=workers)) for _ in range(3))
