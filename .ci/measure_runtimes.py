"""Measures the OpenCL runtimes for the CPU of this machine: the figures behind the order in device/select.py.

Each measurement has a process of its own, in which it is the only driver; the runtimes take turns. Printed are medians
over the rounds of the best of some calls, in milliseconds, and the share of PoCL's time. `compare_runtimes.py
--install` installs the runtimes.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from compare_runtimes import PROJECT, RUNTIMES, Runtime, run_python

WIDTH, HEIGHT = 1280, 720
POINTS = 50_000
CALLS = 5


def measure(mesh_name: str, device: str) -> dict[str, object]:
    """Measure the only driver of this process; a mesh is a file or a procedural shape."""
    import numpy as np

    import clbvh
    from clbvh.views.cameras.framing import frame_mesh

    mesh = clbvh.load_mesh(mesh_name) if Path(mesh_name).is_file() else clbvh.make_shape(mesh_name, triangles=300_000)
    bvh = clbvh.build(mesh)
    random = np.random.default_rng(0)
    origins, directions = frame_mesh(mesh, aspect=WIDTH / HEIGHT).rays(WIDTH, HEIGHT)
    order = random.permutation(WIDTH * HEIGHT)
    shuffled = origins.reshape(-1, 3)[order], directions.reshape(-1, 3)[order]
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    points = low + (high - low) * random.random((POINTS, 3))
    started = time.perf_counter()
    with clbvh.Tracer(bvh, device=device) as tracer:
        tracer.closest_hit(origins, directions)
        first_s = time.perf_counter() - started
        calls = {
            "picture": lambda: tracer.closest_hit(origins, directions),
            "shuffled rays": lambda: tracer.closest_hit(*shuffled),
            "closest points": lambda: tracer.closest_point(points),
        }
        ms = {name: 1e3 * min(_time(call) for _ in range(CALLS)) for name, call in calls.items()}
    return {"device": clbvh.choose_device(device).name, "ms": ms | {"first use": 1e3 * first_s}}


def _time(call: Callable[[], object]) -> float:
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def run(runtime: Runtime, library: Path | None, mesh: str) -> dict[str, object]:
    """Measure one runtime in a process of its own."""
    done = run_python(runtime, library, PROJECT, (__file__, "--only", mesh, runtime.device))
    if done.returncode:
        raise SystemExit(f"{runtime.name}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure all runtimes in turn, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", nargs="*", default=["knot", "terrain", "palace"], help="files or shapes")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--library", action="append", default=[], metavar="RUNTIME=PATH", help="not where it installs")
    parser.add_argument("--only", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.only:
        print(json.dumps(measure(*options.only)))
        return
    meshes = [str(Path(mesh).resolve()) if Path(mesh).is_file() else mesh for mesh in options.meshes]
    named = {name: Path(path) for name, _, path in (text.partition("=") for text in options.library)}
    libraries = {runtime.name: named.get(runtime.name) or runtime.find_library() for runtime in RUNTIMES}
    runtimes = [runtime for runtime in RUNTIMES if libraries[runtime.name] is not None and not runtime.is_simulator]
    taken: dict[tuple[str, str, str], list[float]] = {}
    for _ in range(options.rounds):
        for mesh in meshes:
            for runtime in runtimes:
                report = run(runtime, libraries[runtime.name], mesh)
                print(runtime.name, report["device"], Path(mesh).name, report["ms"], file=sys.stderr, flush=True)
                for query, ms in report["ms"].items():
                    taken.setdefault((Path(mesh).name, query, runtime.name), []).append(ms)
    print("| mesh | query |" + "".join(f" {runtime.name} |" for runtime in runtimes))
    print("|---|---|" + "---|" * len(runtimes))
    for mesh, query in dict.fromkeys((mesh, query) for mesh, query, _ in taken):
        medians = [statistics.median(taken[mesh, query, runtime.name]) for runtime in runtimes]
        cells = [f"{ms:,.0f} ms ({ms / medians[0]:.2f})" for ms in medians]
        print(f"| {mesh} | {query} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
