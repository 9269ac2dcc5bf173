"""Two Dask workers with a core each, against one process: ``python bench/dask_workers.py MESH [MILLIONS]`` of rays.

Prints the seconds of a scene's start, of one process, and of the workers, with the digests of both answers.
"""

import hashlib
import os
import sys
import time
from pathlib import Path

import dask
import dask.array as da
import numpy as np
from distributed import Client, LocalCluster

import clbvh
from clbvh.integrations.dask import closest_hit

CHUNK = 1_000_000


def digest(t, prim_id):
    return np.frombuffer(hashlib.sha256(t.tobytes() + prim_id.tobytes()).digest(), np.uint8)


def make_rays(ref, count):
    mesh = ref.load()[0].snapshot().shapes[0]
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    generator = da.random.default_rng(7)
    shares = [generator.uniform(*bounds, (count * CHUNK, 3), chunks=(CHUNK, 3)) for bounds in ((-1, 2), (0, 1))]
    origins, targets = (lower + each * (upper - lower) for each in shares)
    return origins, targets - origins


def digests(ref, rays):
    hits = closest_hit(ref, *rays)
    chunks = ((32,) * hits["t"].numblocks[0],)
    return da.map_blocks(digest, hits["t"], hits["prim_id"], dtype=np.uint8, chunks=chunks, meta=np.empty(0, np.uint8))


def take_core(dask_worker):
    core = sorted(os.sched_getaffinity(0))[int(dask_worker.name)]
    for thread in Path("/proc/self/task").iterdir():
        os.sched_setaffinity(int(thread.name), {core})


def timed(label, step):
    begin = time.perf_counter()
    found = step()
    print(
        f"{label:10} {time.perf_counter() - begin:6.2f} s  {hashlib.sha256(found.tobytes()).hexdigest()[:12]}",
        flush=True,
    )


def main():
    ref, count = clbvh.SceneRef(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 20
    rays, few = make_rays(ref, count), make_rays(ref, 1)
    begin = time.perf_counter()
    ref.tracer()
    print(f"ref.tracer() {time.perf_counter() - begin:.2f} s")
    with dask.config.set(scheduler="synchronous"):
        digests(ref, few).compute()
        timed("one", lambda: digests(ref, rays).compute())
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        client.run(take_core)
        client.run(lambda: digests(ref, few).compute(scheduler="synchronous"))
        timed("two", lambda: digests(ref, rays).compute())


if __name__ == "__main__":
    main()
