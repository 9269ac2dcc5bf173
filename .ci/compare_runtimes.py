"""Checks the host and every OpenCL runtime here against the stored answers; prints a table for docs/conformance.md.

The host is checked with kernels for each level of processor that this one has, and with those that are compiled where
nothing is known of a processor (`PORTABLE`); they are compiled for it. Each runtime has a process of its own, in which
it is the only driver, and a time limit. `--install` installs what is missing: Intel's runtime into `out/runtimes`, the
others by apt-get without their driver files, so that no other program sees them. A runtime that is not there is skipped
with a reason; a difference, a crash or a timeout is exit code 1.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
VENVS = PROJECT / "out" / "runtimes"
SYSTEM_LIBRARIES = Path("/usr/lib") / f"{platform.machine()}-linux-gnu"

# A first run compiles some 200 programs, one after the other; Oclgrind interprets every instruction.
TIME_LIMIT_S = 600
SIMULATOR_TIME_LIMIT_S = 1800

# Beginnings of the first line of Oclgrind's findings.
_FINDINGS = (
    "Invalid",
    "Index",
    "Uninitialized",
    "Read-write data race",
    "Write-write data race",
    "Write-read data race",
)

# What a simulator has to find: whether a ray hits, written far behind the buffer.
_PLANTED_KERNEL = "kernels/any_hit.cl"
_RIGHT_WRITE = "blocked + ray_id_of(&batch, slot)"
_WRONG_WRITE = "blocked + ray_id_of(&batch, slot) + (1 << 24)"


@dataclass(frozen=True)
class Runtime:
    """An OpenCL runtime, and where it comes from.

    Attributes
    ----------
    name : str
    device : str
        What `--device` takes.
    find_library : function
        Returns its library, or None.
    packages : tuple of str
        Debian's, or, with `venv`, PyPI's.
    venv : str
        Name of the environment that it is installed into; empty for Debian packages.
    environment : dict of str to str
    arguments : tuple of str
        More words for `clbvh doctor --conformance`.
    time_limit_s : float
    is_simulator : bool
        Whether it prints wrong accesses.
    """

    name: str
    device: str
    find_library: Callable[[], Path | None]
    packages: tuple[str, ...] = ()
    venv: str = ""
    environment: dict[str, str] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    time_limit_s: float = TIME_LIMIT_S
    is_simulator: bool = False


def _find_bundled() -> Path | None:
    """Return PoCL beside pyopencl."""
    import importlib.util

    spec = importlib.util.find_spec("pyopencl")
    found = sorted((Path(spec.origin).parent / ".libs").glob("libpocl*")) if spec and spec.origin else []
    return found[0] if found else None


def _find_system(name: str) -> Callable[[], Path | None]:
    return lambda: next((path for path in [SYSTEM_LIBRARIES / name, Path("/usr/lib") / name] if path.exists()), None)


def _find_intel() -> Path | None:
    return next(iter(sorted((VENVS / "intel" / "lib").glob("libintelocl.so"))), None)


RUNTIMES = (
    Runtime("pocl", "pocl", _find_bundled),
    Runtime("debian-pocl", "pocl", _find_system("libpocl.so.2"), ("pocl-opencl-icd",)),
    Runtime("intel", "intel", _find_intel, ("intel-opencl-rt", "intel-cmplr-lib-rt"), venv="intel"),
    Runtime(
        "rusticl",
        "rusticl",
        _find_system("libRusticlOpenCL.so.1"),
        ("mesa-opencl-icd", "libclang-common-15-dev"),
        environment={"RUSTICL_ENABLE": "llvmpipe"},
    ),
    Runtime(
        "oclgrind",
        "oclgrind",
        _find_system("oclgrind/liboclgrind-rt-icd.so"),
        ("oclgrind",),
        environment={"OCLGRIND_DATA_RACES": "1"},
        time_limit_s=SIMULATOR_TIME_LIMIT_S,
        is_simulator=True,
    ),
)


@dataclass(frozen=True)
class Outcome:
    """The result of one runtime: a row of the table."""

    runtime: str
    device: str
    driver: str
    answer: str
    seconds: float
    is_failure: bool = False


def install(runtime: Runtime) -> str:
    """Install a runtime; return the reason if that fails."""
    if not runtime.packages:
        return "`pip install 'clbvh[pocl]'` brings it"
    if runtime.venv:
        folder = VENVS / runtime.venv
        commands = [
            [sys.executable, "-m", "venv", str(folder)],
            [str(folder / "bin" / "pip"), "install", "--quiet", "--disable-pip-version-check", *runtime.packages],
        ]
    else:
        options = ["-y", "-qq", "--no-install-recommends", "-o", "Dpkg::Options::=--path-exclude=/etc/OpenCL/*"]
        commands = [["apt-get", "update", "-qq"], ["apt-get", "install", *options, *runtime.packages]]
    for command in commands:
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError as error:
            return str(error)
        if done.returncode:
            lines = (done.stderr or done.stdout).strip().splitlines()
            return f"`{command[0]}` failed: {lines[-1] if lines else done.returncode}"
    return ""


def check_runtime(runtime: Runtime, library: Path | None) -> Outcome:
    """Run the check in a process whose only driver is this runtime; None for what the process finds by itself."""
    started = time.perf_counter()
    try:
        findings, done = run_check(runtime, library, PROJECT)
    except subprocess.TimeoutExpired:
        return Outcome(runtime.name, "", "", f"no answer within {runtime.time_limit_s:g} s", 0.0, is_failure=True)
    seconds = time.perf_counter() - started
    try:
        report = json.loads(done.stdout)
    except ValueError:
        lines = done.stderr.strip().splitlines()
        reason = lines[-1] if lines else f"exit code {done.returncode}"
        return Outcome(runtime.name, "", "", reason, seconds, is_failure=True)
    for difference in report["differences"]:
        print(f"{runtime.name}: {difference}", file=sys.stderr)
    device = report["device"]
    answer, is_failure = describe_report(report), not report["is_equal"] or findings > 0
    if runtime.is_simulator and library is not None:
        finds_planted = finds_planted_write(runtime, library)
        answer += f"; {findings} findings; a planted write is {'found' if finds_planted else 'NOT found'}"
        is_failure |= not finds_planted
    return Outcome(runtime.name, device["name"], device["driver_version"], answer, seconds, is_failure)


def run_check(runtime: Runtime, library: Path | None, package: Path) -> tuple[int, subprocess.CompletedProcess[str]]:
    """Run `clbvh doctor --conformance` of the package in a folder; return a simulator's findings, and the process."""
    words = "-m", "clbvh", "doctor", "--conformance", "--json", "--device", runtime.device, *runtime.arguments
    done = run_python(runtime, library, package, words, timeout=runtime.time_limit_s)
    return count_findings(done.stderr) if runtime.is_simulator else 0, done


def run_python(
    runtime: Runtime, library: Path | None, package: Path, words: Sequence[str], *, timeout: float | None = None
) -> subprocess.CompletedProcess[str]:
    """Run Python with these words, and with this runtime as the only driver; None for what it finds by itself."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | runtime.environment | {"PYTHONPATH": str(package)}
        environment.pop("CLBVH_DEVICE", None)
        if runtime.name == "pocl":
            # The loader inside pyopencl always reads the folder beside it, and here no other one.
            environment["OCL_ICD_VENDORS"] = folder
        elif library is not None:
            icd = Path(folder) / "runtime.icd"
            icd.write_text(f"{library}\n")
            environment["OCL_ICD_VENDORS"] = str(icd)
            searched = [str(library.parent), environment.get("LD_LIBRARY_PATH", "")]
            environment["LD_LIBRARY_PATH"] = os.pathsep.join(filter(None, searched))
        command = [sys.executable, *words]
        return subprocess.run(
            command, env=environment, cwd=package, capture_output=True, text=True, timeout=timeout, check=False
        )


def finds_planted_write(runtime: Runtime, library: Path) -> bool:
    """Return whether the same set-up finds a kernel that writes behind its buffer."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        shutil.copytree(PROJECT / "clbvh", copy / "clbvh", ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copytree(PROJECT / "cl", copy / "clbvh" / "cl")
        kernel = copy / "clbvh" / "cl" / _PLANTED_KERNEL
        text = kernel.read_text()
        if _RIGHT_WRITE not in text:
            raise SystemExit(f"{_PLANTED_KERNEL} has no '{_RIGHT_WRITE}': plant the wrong write elsewhere")
        kernel.write_text(text.replace(_RIGHT_WRITE, _WRONG_WRITE))
        findings, _ = run_check(replace(runtime, arguments=("--mesh", "single")), library, copy)
        return findings > 0


def count_findings(errors: str) -> int:
    """Return the number of findings that Oclgrind printed."""
    return sum(line.startswith(_FINDINGS) for line in errors.splitlines())


def describe_report(report: dict) -> str:
    """Return the number of parts that are equal, and of those that are not."""
    part_count = sum(entry["parts"] for entry in report["compared"])
    differing = len(report["differences"])
    words = [f"{part_count - differing} of {part_count} equal"]
    if report["unusable"]:
        words.append(f"not comparable here: {', '.join(report['unusable'])}")
    return "; ".join(words)


def compile_hosts(folder: Path) -> Iterator[Runtime]:
    """Compile the kernels for all levels of this processor, and portably for the lowest one; yield their runtimes.

    Raises
    ------
    DeviceError
        There is no compiler.
    """
    from clbvh.device.host.compile import build_library, find_level, find_objects, find_own_target
    from clbvh.device.host.library import LEVEL_VARIABLE, LIBRARY_VARIABLE
    from clbvh.device.host.variants import list_variants

    highest, target = find_level(), find_own_target()
    known = list(target.levels) if target else []
    levels = known[: known.index(highest) + 1]
    # The slowest ones to compile, of which no answer is stored.
    variants = [variant for variant in list_variants() if variant.name != "render_samples"]
    for name, library, chosen, macros in (
        ("host", folder / "levels.so", levels, {}),
        ("host PORTABLE", folder / "portable.so", levels[:1], {"PORTABLE": 1}),
    ):
        build_library(library, find_objects(), chosen, variants=variants, macros=macros)
        for level in chosen:
            environment = {LIBRARY_VARIABLE: str(library), LEVEL_VARIABLE: level}
            yield Runtime(f"{name} {level}", "host", lambda: None, environment=environment)


def check_hosts() -> list[Outcome]:
    """Check the host with all of its compiled kernels; none without a compiler."""
    from clbvh import DeviceError

    with tempfile.TemporaryDirectory() as folder:
        try:
            return [check_runtime(runtime, None) for runtime in compile_hosts(Path(folder))]
        except DeviceError as error:
            print(f"host: skipped, {error}", file=sys.stderr)
            return []


def find_gpus() -> list[Runtime]:
    """Return one runtime for each GPU among the drivers of this machine."""
    command = [sys.executable, "-m", "clbvh", "devices", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=PROJECT, check=False)
    try:
        devices = json.loads(done.stdout)["devices"]
    except (ValueError, KeyError):
        return []
    gpus = [device for device in devices if device["kind"] == "gpu"]
    return [Runtime(f"gpu {device['number']}", str(device["number"]), lambda: None) for device in gpus]


def print_table(outcomes: Sequence[Outcome]) -> None:
    """Print the outcomes as Markdown."""
    print(f"\n{date.today().isoformat()}, {platform.platform()}\n")
    print("| runtime | device | driver | answers | s |")
    print("|---|---|---|---|---|")
    for row in outcomes:
        print(f"| {row.runtime} | {row.device} | {row.driver} | {row.answer} | {row.seconds:.0f} |")


def main(arguments: Sequence[str] | None = None) -> int:
    """Check the runtimes, print the table, and return the exit code."""
    names = [runtime.name for runtime in RUNTIMES]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runtimes", nargs="*", help=f"any of host, {', '.join(names)}, gpu; all without it")
    parser.add_argument("--install", action="store_true", help="install what is missing")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.runtimes) - {"host", *names, "gpu"})
    if unknown:
        parser.error(f"'{unknown[0]}' is no runtime: there are host, {', '.join(names)} and gpu")
    wanted = options.runtimes or ["host", *names, "gpu"]

    outcomes = check_hosts() if "host" in wanted else []
    for runtime in (runtime for runtime in RUNTIMES if runtime.name in wanted):
        library = runtime.find_library()
        reason = ""
        if library is None and options.install:
            reason = install(runtime)
            library = runtime.find_library()
        if library is None:
            needed = f"needs {' '.join(runtime.packages)}" if runtime.packages else "not installed"
            print(f"{runtime.name}: skipped, {reason or needed}", file=sys.stderr)
            continue
        print(f"{runtime.name}: {library}", file=sys.stderr)
        outcomes.append(check_runtime(runtime, library))
    if "gpu" in wanted:
        outcomes += [check_runtime(runtime, None) for runtime in find_gpus()]
    print_table(outcomes)
    # Nothing compared is no success.
    return 1 if not outcomes or any(outcome.is_failure for outcome in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
