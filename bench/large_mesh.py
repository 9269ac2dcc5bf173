"""Large meshes: time and memory of each step from a file to hits; and shards against the whole mesh.

``python bench/large_mesh.py 100_000_000`` writes a height field of 100 million triangles as a temporary file, and
prints a table. ``python bench/large_mesh.py 10_000_000 --shards 10`` casts as many rays at the mesh and at
its shards, each in a process of its own, twice; all trees are kept from the first time. Linux alone.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import clbvh

SIZE = 10.0  # of the field
ANSWER_BYTES = 29  # t, u, v, prim_id and is_front of a ray


def write_field(path: Path, triangles: int) -> None:
    """Write a height field as a binary PLY file, row by row."""
    side = int(np.sqrt(triangles / 2))
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {(side + 1) ** 2}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {2 * side**2}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    generator, x = np.random.default_rng(1), np.linspace(0, SIZE, side + 1)
    rows = np.empty(2 * side, [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"] = 3
    with path.open("wb") as file:
        file.write(header.encode())
        for y in x:
            noise = generator.normal(0, 0.3 * SIZE / side, side + 1)
            z = np.sin(3 * x) * np.cos(2 * y) + 0.3 * np.sin(17 * x + 5 * y) + noise
            file.write(np.column_stack((x, np.full_like(x, y), z)).astype("<f4").tobytes())
        for row in range(side):
            a = row * (side + 1) + np.arange(side, dtype=np.int32)
            rows["corners"][0::2] = np.column_stack((a, a + 1, a + side + 2))
            rows["corners"][1::2] = np.column_stack((a, a + side + 2, a + side + 1))
            file.write(rows.tobytes())


def make_rays(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rays from above, in no order."""
    generator = np.random.default_rng(2)
    directions = generator.normal(0, 0.3, (count, 3))
    directions[:, 2] = -1
    return np.column_stack((generator.uniform(0, SIZE, (count, 2)), np.full(count, 5.0))), directions


def memory(key: str) -> float:
    """Return a line of the system's account of this process, in GB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key)) * 1024 / 1e9


def forget_peak() -> None:
    """Let the peak of the memory begin anew."""
    Path("/proc/self/clear_refs").write_text("5")


def timed(label: str, step: Callable[[], Any]) -> Any:
    """Print the time of a step, the peak of the memory meanwhile, and what is left."""
    forget_peak()
    begin = time.perf_counter()
    result = step()
    spent = time.perf_counter() - begin
    print(f"{label:26} {spent:8.2f} s   peak {memory('VmHWM'):6.2f} GB   left {memory('VmRSS'):6.2f} GB", flush=True)
    return result


def compile_all() -> None:
    """Let a first use, of a small mesh, not count."""
    small = clbvh.make_shape("terrain", triangles=5000)
    for layout in ("bvh8", "bvh8c"):
        with clbvh.Tracer(clbvh.build(small), layout=layout) as tracer:
            tracer.closest_hit(*make_rays(100_000))


def trace_whole(path: Path, layout: str) -> None:
    """Print the table of one mesh."""
    compile_all()
    mesh = timed("load", lambda: clbvh.load_mesh(path))
    bvh = timed("build", lambda: clbvh.build(mesh))
    tracer = timed("open the tracer", lambda: clbvh.Tracer(bvh, layout=layout))
    rays = make_rays(1_000_000)
    timed("cast a million rays", lambda: tracer.closest_hit(*rays))
    print(f"{tracer.layout}: {tracer.memory_bytes / mesh.face_count:.1f} bytes a triangle on the device")


def trace_side(source: Path, count: int) -> None:
    """Cast rays at a mesh and its kept tree, or at shards; print times, the peak beside rays and answers, a digest."""
    compile_all()
    rays = make_rays(count)
    forget_peak()
    before, begin = memory("VmRSS"), time.perf_counter()
    if source.is_dir():
        tracer: Any = clbvh.ShardedTracer(source)
    else:
        mesh, tree = clbvh.load_mesh(source), source.with_suffix(".tree")
        if not tree.exists():
            clbvh.build(mesh).save(tree)
        tracer = clbvh.Tracer(clbvh.Bvh.load(tree, mesh))
        del mesh
    opened = time.perf_counter()
    hits = tracer.closest_hit(*rays)
    done = time.perf_counter()
    digest = hashlib.sha256(hits.t.tobytes() + hits.prim_id.tobytes()).hexdigest()[:12]
    peak = memory("VmHWM") - before - ANSWER_BYTES * count / 1e9
    print(f"opened in {opened - begin:6.2f} s, cast in {done - opened:6.2f} s, peak {peak:5.2f} GB, hits {digest}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("triangles", type=int)
    parser.add_argument("--shards", type=int)
    parser.add_argument("--layout", default="auto")
    parser.add_argument("--side", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.side:
        trace_side(options.side, options.triangles)
        return
    with tempfile.TemporaryDirectory() as folder:
        path, parts = Path(folder, "field.ply"), Path(folder, "parts")
        write_field(path, options.triangles)
        if not options.shards:
            trace_whole(path, options.layout)
            return
        each = -(-options.triangles // options.shards)
        timed("cut", lambda: clbvh.shard_mesh(path, parts, triangles=each))
        for turn in range(2):
            for source in (path, parts):
                side = [sys.executable, __file__, str(options.triangles), "--side", str(source)]
                print(
                    turn, source.name, subprocess.run(side, check=True, capture_output=True, text=True).stdout.strip()
                )


if __name__ == "__main__":
    main()
