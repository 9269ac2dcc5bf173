"""A GPU's first day: checks every kernel on it, and measures rays, builds and the study's pictures in ten minutes.

It takes the first GPU, or the device of `--device`, which it treats as a GPU. Each step is a process of its own, whose
rows are kept as they come: where one fails, crashes or takes too long, the page says so, and the next one begins. The
folder gets `gpu-day.md`, `gpu-day.json` and the samples of the study. Exit code 1 if a step fails or an answer differs.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

Row = dict[str, Any]

DAY_S = 600.0
# What is left for the page, and for steps that end late.
_RESERVE_S = 15.0
# The first use of a GPU after boot can take ten seconds.
_START_S = 60.0

# Characters of an error: a compiler's log may follow.
_LONGEST = 300

CALLS = 5
_TITLES = {
    "conformance": "Answers that are equal to the stored ones",
    "rays": "Million rays per second",
    "builds": "Builds and refits on the device",
    "work": "Each kind of work, compiled and run once",
    "kernels": "Kernels, as the driver reports them",
}
# Of the study: those that draw or build on the device.
EXPERIMENTS = ("ladder", "trees", "frontier", "resolution", "layouts")


class Size(NamedTuple):
    """How much is measured.

    Attributes
    ----------
    picture : (int, int)
        Rays of a picture.
    meshes, builds : tuple of str
        Procedural meshes, by name and triangles: those for rays, and those to build trees of.
    """

    picture: tuple[int, int]
    meshes: tuple[str, ...]
    builds: tuple[str, ...]


FULL = Size((1920, 1080), ("knot-1000000", "terrain-1000000"), ("knot-100000", "knot-1000000", "knot-10000000"))
SMALL = Size((320, 180), ("knot-20000",), ("knot-20000",))


def check_answers(info: Any, size: Size, folder: Path) -> Iterator[Row]:
    """Compare the answers of all layouts, then trees with tiles of one work-item, as devices for CPUs have them."""
    from clbvh.conformance.check import ALL_LAYOUTS, check_device

    checks = [(layout, info, (layout,)) for layout in ALL_LAYOUTS]
    checks.append(("trees, tiles of one work-item", replace(info, kind="cpu"), ()))
    for name, device, layouts in checks:
        started = time.perf_counter()
        result = check_device(device, layouts=layouts)
        yield {
            "table": "conformance",
            "answers": name,
            "parts": sum(result.compared.values()),
            "differ": len(result.differences),
            "not comparable here": len(result.unusable),
            "first difference": str(result.differences[0]) if result.differences else "",
            "s": time.perf_counter() - started,
        }
    yield from describe_kernels(info)


def describe_kernels(info: Any) -> Iterator[Row]:
    """Yield what the driver says of every kernel that this process has compiled for a device."""
    import pyopencl as cl
    from gpu_report import read_ptxas

    from clbvh.device.context import open_context

    facts, of_program = cl.kernel_work_group_info, cl.program_build_info
    device, seen = info.cl_device, set()
    for kernel in open_context(info).list_kernels():
        handle = kernel.cl_kernel
        program = handle.get_info(cl.kernel_info.PROGRAM)
        options = program.get_build_info(device, of_program.OPTIONS)
        macros = " ".join(sorted(word.removeprefix("-D") for word in options.split() if word.startswith("-D")))
        if (kernel.name, macros) in seen:
            continue
        seen.add((kernel.name, macros))
        in_log = read_ptxas(program.get_build_info(device, of_program.LOG) or "").get(kernel.name)
        yield {
            "table": "kernels",
            "kernel": kernel.name,
            "macros": macros,
            "registers": in_log[0] if in_log else None,
            "spilled, bytes": in_log[2] if in_log else None,
            "private, bytes": handle.get_work_group_info(facts.PRIVATE_MEM_SIZE, device),
            "local, bytes": handle.get_work_group_info(facts.LOCAL_MEM_SIZE, device),
            "largest work-group": handle.get_work_group_info(facts.WORK_GROUP_SIZE, device),
            "of multiples of": handle.get_work_group_info(facts.PREFERRED_WORK_GROUP_SIZE_MULTIPLE, device),
        }


def measure_rays(info: Any, size: Size, folder: Path) -> Iterator[Row]:
    """Measure rays of a picture, the same in no order, and rays from anywhere in the box in any direction."""
    import numpy as np

    import clbvh
    from clbvh.study.scale import QUICK, load_named_mesh
    from clbvh.tree_layouts import TREE_LAYOUTS
    from clbvh.views.cameras.framing import frame_mesh

    width, height = size.picture
    # The scans that are here: a study has other meshes in the place of those that are not.
    scans = [scan for scan in ("bunny", "dragon") if size is FULL and QUICK.mesh(scan) == scan]
    for name in (*size.meshes, *scans):
        mesh, random = load_named_mesh(name), np.random.default_rng(0)
        picture = frame_mesh(mesh, aspect=width / height).rays(width, height)
        order = random.permutation(width * height)
        lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        batches = {
            "picture": picture,
            "shuffled": [np.ascontiguousarray(rays.reshape(-1, 3)[order]) for rays in picture],
            "scattered": (random.uniform(lower, upper, (width * height, 3)), random.normal(size=(width * height, 3))),
        }
        bvh = clbvh.build(mesh)
        for layout in TREE_LAYOUTS:
            with clbvh.Tracer(bvh, device=info, layout=layout) as tracer:
                for batch, rays in batches.items():
                    row = {"table": "rays", "mesh": name, "layout": layout, "rays": batch}
                    for query in ("closest_prim", "any_hit", "closest_hit"):
                        kernel_ms, call_ms = time_query(tracer, getattr(tracer, query), rays)
                        row[f"{query}, kernels"] = width * height / 1e3 / kernel_ms if kernel_ms else None
                        row[f"{query}, call"] = width * height / 1e3 / call_ms
                    yield row


def time_query(tracer: Any, query: Callable[..., object], rays: Sequence[Any]) -> tuple[float, float]:
    """Return the medians of the kernels' time by the device's clock, and of the call from array to array, in ms."""
    query(*rays)
    kernels, calls = [], []
    for _ in range(CALLS):
        before, started = tracer.timings_ms.get("kernel", 0.0), time.perf_counter()
        query(*rays)
        calls.append(1e3 * (time.perf_counter() - started))
        kernels.append(tracer.timings_ms.get("kernel", 0.0) - before)
    return statistics.median(kernels), statistics.median(calls)


def measure_builds(info: Any, size: Size, folder: Path) -> Iterator[Row]:
    """Measure builds on the device beside the host's, and refits of a tracer whose mesh moves."""
    import numpy as np

    import clbvh
    from clbvh.study.scale import load_named_mesh

    for name in size.builds:
        mesh = load_named_mesh(name)
        million = mesh.face_count / 1e6
        fast = [clbvh.build(mesh, quality="fast", device=info).timings_ms for _ in range(CALLS)][1:]
        on_device_ms = statistics.median(sum(ms[phase] for phase in ("sort", "merge", "place")) for ms in fast)
        whole_ms = statistics.median(sum(ms.values()) for ms in fast)
        host_ms = statistics.median(sum(clbvh.build(mesh).timings_ms.values()) for _ in range(2))
        row = {
            "table": "builds",
            "mesh": name,
            "on the device, ms": on_device_ms,
            "Mtri/s": 1e3 * million / on_device_ms,
            "from and to the host, ms": whole_ms,
            "the host's default build, ms": host_ms,
        }
        with clbvh.Tracer(mesh, device=info, quality="fast") as tracer:
            moved, times = mesh.vertices.astype(np.float64), []
            for _ in range(CALLS):
                moved = moved * (1.0 + 1e-4)
                started = time.perf_counter()
                tracer.update(moved)
                tracer.any_hit(np.zeros(3), np.ones(3))  # waits for the device
                times.append(1e3 * (time.perf_counter() - started))
            row["refit with a ray, ms"] = statistics.median(times[1:])  # the first one compiles
        yield row


def measure_experiment(name: str) -> Callable[[Any, Size, Path], Iterator[Row]]:
    """Return the step of one experiment of the study, whose samples are kept in a folder of their own."""

    def measure(info: Any, size: Size, folder: Path) -> Iterator[Row]:
        from clbvh.study.experiments import find_experiments
        from clbvh.study.machine import describe_machine, keep_machine
        from clbvh.study.run import take_samples
        from clbvh.study.samples import SampleFile
        from clbvh.study.scale import QUICK, TINY

        machine = replace(describe_machine(str(info.number)), device=info)
        folder.mkdir(exist_ok=True)
        keep_machine(folder, machine)
        samples = SampleFile(folder, machine.digest)
        take_samples(find_experiments([name]), QUICK if size is FULL else TINY, machine, samples, folder / "pictures")
        for failure in samples.failures(name):
            yield {"table": "failures", "work": str(failure["case"]), "problem": failure["reason"][:_LONGEST]}

    return measure


def do_all_work(info: Any, size: Size, folder: Path) -> Iterator[Row]:
    """Do each kind of work once: all shadings, queries and changes, of meshes, spheres and scenes."""
    from clbvh.errors import ClbvhError
    from clbvh.warmup import list_work

    for what, work in list_work(info):
        started, problem = time.perf_counter(), ""
        try:
            work()
        except ClbvhError as error:
            problem = str(error)
        yield {"table": "work", "work": what, "s": time.perf_counter() - started, "problem": problem}


class Step(NamedTuple):
    """A step: what it yields, and the seconds that it may take."""

    run: Callable[[Any, Size, Path], Iterator[Row]]
    limit_s: float


STEPS = {
    "conformance": Step(check_answers, 300),
    "rays": Step(measure_rays, 150),
    "builds": Step(measure_builds, 90),
    **{name: Step(measure_experiment(name), 90) for name in EXPERIMENTS},
    "work": Step(do_all_work, 300),
}


def run_step(name: str, device: str, size: Size, folder: Path) -> int:
    """Run one step in this process, write its rows as they come, and return the exit code; what fails is one line."""
    from clbvh.device.select import choose_device

    info = replace(choose_device(device), kind="gpu")
    with (folder / f"{name}.jsonl").open("w", encoding="utf-8") as file:
        try:
            for row in STEPS[name].run(info, size, folder / "study"):
                file.write(json.dumps(row) + "\n")
                file.flush()
        except Exception as error:  # a driver may raise anything
            traceback.print_exc()
            print(f"{type(error).__name__}: {' '.join(str(error).split())[:_LONGEST]}", file=sys.stderr)
            return 1
    return 0


def start_step(name: str, device: str, options: argparse.Namespace, limit_s: float) -> tuple[str, float, list[Row]]:
    """Run a step in a process; return what went wrong, the seconds, and its rows."""
    command = [sys.executable, str(Path(__file__).resolve()), "--step", name, "--device", device]
    command += ["--folder", str(options.folder), *(["--small"] if options.small else [])]
    environment = dict(os.environ)
    if name == "conformance":
        # NVIDIA's compiler says how many registers a kernel takes, but not of a program that it finds in a cache.
        environment |= {"PYOPENCL_NO_CACHE": "1", "CUDA_CACHE_DISABLE": "1"}
        if options.is_nvidia:
            environment["PYOPENCL_BUILD_OPTIONS"] = "-cl-nv-verbose"
    started, problem = time.perf_counter(), ""
    with tempfile.TemporaryFile("w+", encoding="utf-8") as errors:
        process = subprocess.Popen(command, env=environment, stderr=errors)
        try:
            code = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            problem, code = f"not finished within {limit_s:.0f} s", 0
        except KeyboardInterrupt:
            process.kill()
            process.wait()
            raise
        errors.seek(0)
        lines = errors.read().strip().splitlines()
    if code:
        ended = f"ended by {signal.Signals(-code).name}" if code < 0 else ""
        problem = ": ".join(filter(None, [ended, *lines[-1:]])) or f"exit code {code}"
    path, rows = options.folder / f"{name}.jsonl", []
    for line in path.read_text("utf-8").splitlines() if path.is_file() else ():
        with suppress(ValueError):  # the last line of a process that was killed
            rows.append(json.loads(line))
    return problem, time.perf_counter() - started, rows


def find_problem(rows: Sequence[Row]) -> str:
    """Return the first thing that went wrong in rows, or nothing."""
    for row in rows:
        if row["table"] == "conformance" and row["differ"] + row["not comparable here"]:
            return f"{row['answers']}: {row['differ']} of {row['parts']} answers are not the stored ones"
        if row.get("problem"):
            return f"{row['work']}: {row['problem']}"
    return ""


def find_gpu(spec: str | None) -> Row | None:
    """Return the first GPU, or a device by its number or a part of its name; asked for in a process of its own."""
    code = "import clbvh, json, sys; print(json.dumps(clbvh.choose_device(sys.argv[1]).as_dict()))"
    command = [sys.executable, "-c", code, spec or "gpu"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_START_S)
    except subprocess.TimeoutExpired:
        print(f"no driver has answered within {_START_S:.0f} s", file=sys.stderr)
        return None
    if done.returncode:
        print(done.stderr.strip().splitlines()[-1], file=sys.stderr)
        return None
    return json.loads(done.stdout)


def write_page(day: Row, folder: Path) -> str:
    """Return the page: the machine, the steps, and a table for each kind of row and each experiment."""
    from clbvh.errors import ClbvhError
    from clbvh.study.experiments import EXPERIMENTS as KNOWN
    from clbvh.study.page import Table, write_table
    from clbvh.study.publish import open_study

    device = day["device"]
    facts = f"{device['name']}, {device['platform']}, driver {device['driver_version']}, {device['version'].strip()}"
    lines = [f"# {device['name']}", "", f"{facts}. {day['machine']}. {day['date']}, clbvh {day['clbvh']}."]
    rows = [(name, step["problem"] or "done", step["s"]) for name, step in day["steps"].items()]
    lines += ["", write_table(Table("", ("step", "", "s"), rows))]
    for table, title in _TITLES.items():
        of_table = [row for step in day["steps"].values() for row in step["rows"] if row["table"] == table]
        if of_table:
            columns = [column for column in of_table[0] if column != "table"]
            cells = [[row[column] for column in columns] for row in of_table]
            lines += ["", f"## {title}", "", write_table(Table("", columns, cells))]
    try:
        study = open_study(folder / "study")
    except ClbvhError as error:
        return "\n".join([*lines, "", f"No experiment of the study has results: {error}", ""])
    for name, results in study.items():
        if results.cases or results.failures:
            section = KNOWN[name].make_section(results)
            lines += ["", f"## {section.title}", "", section.question]
            for part in section.tables:
                lines += ["", part.caption, "", write_table(part)]
            lines += ["", *section.notes]
    return "\n".join([*lines, ""])


def run_day(options: argparse.Namespace) -> int:
    """Run all steps, write the page, and return the exit code."""
    import platform

    from clbvh.support.version import __version__

    begin = time.monotonic()
    if (options.folder / "gpu-day.json").exists():
        print(f"{options.folder} has another day: move it, or name another folder by --folder", file=sys.stderr)
        return 1
    options.folder.mkdir(parents=True, exist_ok=True)
    # Drivers that no file names, as in containers, are registered for this day alone.
    os.environ.setdefault("CLBVH_DRIVERS", str(options.folder / "drivers"))
    with suppress(subprocess.TimeoutExpired):
        command = [sys.executable, "-m", "clbvh", "doctor", "--fix"]
        subprocess.run(command, stdout=subprocess.DEVNULL, timeout=2 * _START_S, check=False)
    device = find_gpu(options.device)
    if device is None:
        return 1
    options.is_nvidia = "nvidia" in device["vendor"].lower()
    print(f"{device['name']}, {device['platform']}, driver {device['driver_version']}", flush=True)
    day: Row = {
        "device": device,
        "machine": f"{os.cpu_count()} cores, {platform.platform()}, Python {platform.python_version()}",
        "date": time.strftime("%Y-%m-%d"),
        "clbvh": __version__,
        "steps": {},
    }
    for name in options.steps or STEPS:
        step = STEPS[name]
        left_s = DAY_S - _RESERVE_S - (time.monotonic() - begin)
        problem, seconds, rows = "no time was left", 0.0, []
        if left_s > 0:
            problem, seconds, rows = start_step(name, str(device["number"]), options, min(step.limit_s, left_s))
        problem = problem or find_problem(rows)
        day["steps"][name] = {"problem": problem, "s": seconds, "rows": rows}
        print(f"{name}: {problem or 'done'}, {seconds:.0f} s", flush=True)
        # Kept after each step: whatever happens to the machine, what it has measured is there.
        (options.folder / "gpu-day.json").write_text(json.dumps(day, indent=1) + "\n", encoding="utf-8")
        (options.folder / "gpu-day.md").write_text(write_page(day, options.folder), encoding="utf-8")
    print(options.folder / "gpu-day.md")
    return 1 if any(step["problem"] for step in day["steps"].values()) else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the day, or one of its steps, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("steps", nargs="*", metavar="STEP", help=f"any of {', '.join(STEPS)}; all without it")
    parser.add_argument("--device", help="a number or a part of a name; the first GPU without it")
    parser.add_argument("--folder", type=Path, default=Path("gpu-day"), help="new or empty")
    parser.add_argument("--small", action="store_true", help="small meshes and pictures: a trial of two minutes")
    parser.add_argument("--step", choices=STEPS, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if unknown := sorted({*options.steps} - {*STEPS}):
        parser.error(f"'{unknown[0]}' is no step: there are {', '.join(STEPS)}")
    options.folder = options.folder.resolve()
    if options.step:
        return run_step(options.step, options.device, SMALL if options.small else FULL, options.folder)
    return run_day(options)


if __name__ == "__main__":
    sys.exit(main())
