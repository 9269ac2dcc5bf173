"""The machine of a study: processor, memory, versions and drivers, what is missing, and its hardware counters.

Samples are only compared with samples of the same machine and the same versions; a digest of these facts says so.
"""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path

import psutil

from ..device.info import DeviceInfo
from ..device.select import choose_device, list_devices
from ..errors import DeviceError
from ..support.files import write_atomically
from ..support.folders import find_folder
from ..support.host_threads import usable_cores
from .samples import NotMeasuredError

FILE_NAME = "machines.json"

# Events of `perf stat`, and the names of their quantities.
EVENTS = {"instructions": "instructions", "cache-misses": "cache_misses"}

# Packages whose version can change a figure.
_MEASURED = ("clbvh", "numpy", "pyopencl", "trimesh", "rtree", "open3d", "embreex")
_PRESENTING_ROOMS = ("cli", "conformance", "study")
_DIGITS = 12
_GIB = 1 << 30

# Builds some trees.
_BUILD = """
import sys
from clbvh.builders.build import build
from clbvh.study.scale import load_named_mesh
mesh = load_named_mesh(sys.argv[1])
for _ in range(int(sys.argv[3])):
    build(mesh, builder=sys.argv[2])
"""
_LEAST_BUILDS, _MOST_BUILDS = 1, 3
_TIMEOUT_S = 600


@dataclass(frozen=True)
class Machine:
    """The facts of a machine.

    Attributes
    ----------
    facts : dict of str to str
        By the name that the page shows.
    device : DeviceInfo or None
        The one that is measured; None if there is none.
    problem : str
        Why there is no device.
    """

    facts: dict[str, str]
    device: DeviceInfo | None
    problem: str = ""

    @property
    def digest(self) -> str:
        """A short text that is equal for equal facts."""
        return hashlib.sha256(json.dumps(self.facts, sort_keys=True).encode()).hexdigest()[:_DIGITS]


def describe_machine(device: str | None = None) -> Machine:
    """Return the facts of this machine.

    Parameters
    ----------
    device : str, optional
        The device to measure; see `choose_device`.

    Raises
    ------
    DeviceError
        A device was asked for, and there is no such one.
    """
    devices: list[DeviceInfo] = []
    chosen, problem = None, ""
    try:
        devices = [info for info in list_devices() if info.is_available]
        chosen = choose_device(device)
    except DeviceError as error:
        if device is not None:
            raise
        problem = str(error)
    facts = {
        "processor": _find_processor(),
        "cores": str(usable_cores()),
        "memory": f"{psutil.virtual_memory().total / _GIB:.0f} GiB",
        "system": f"{platform.system()} {platform.release()}, {platform.machine()}",
        "python": platform.python_version(),
        **{name: version for name in _MEASURED if (version := find_version(name)) is not None},
        "sources": _digest_sources(),
        "device": "none" if chosen is None else _describe(chosen),
        "device kind": "missing" if chosen is None else chosen.kind,
        **{f"device {info.number}": _describe(info) for info in devices},
    }
    return Machine(facts, chosen, problem)


def find_version(package: str) -> str | None:
    """Return the version of an installed package, None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def list_missing(packages: tuple[str, ...]) -> str:
    """Return the packages that are not installed, as text."""
    return ", ".join(package for package in packages if find_version(package) is None)


def keep_machine(folder: Path, machine: Machine) -> list[str]:
    """Keep the facts of a machine beside its samples.

    Returns
    -------
    list of str
        What differs from the machine of the study before in this folder, one sentence each; empty if nothing does.
    """
    kept = read_machines(folder)
    changes: list[str] = []
    if kept and machine.digest not in kept:
        *_, before = kept.values()
        names = {**before, **machine.facts}
        both = [(name, before.get(name, "missing"), machine.facts.get(name, "missing")) for name in names]
        changes = [f"{name} was {was}, and is {now}" for name, was, now in both if was != now]
    # The latest one stands last.
    kept.pop(machine.digest, None)
    kept[machine.digest] = machine.facts
    write_atomically(folder / FILE_NAME, lambda file: file.write(json.dumps(kept, indent=2).encode()))
    return changes


def read_machines(folder: Path) -> dict[str, dict[str, str]]:
    """Return the facts of the machines of a folder by their digests, the latest last."""
    path = folder / FILE_NAME
    return json.loads(path.read_text("utf-8")) if path.is_file() else {}


@cache
def find_counter_problem() -> str:
    """Return why there are no hardware counters here; empty if there are."""
    try:
        _run_perf([sys.executable, "-c", "pass"])
    except NotMeasuredError as error:
        return str(error)
    return ""


def count_build(mesh: str, builder: str) -> dict[str, float]:
    """Return the events of one build in one process by Linux's `perf stat`, by the names in `EVENTS`.

    A process builds one tree under perf, and another one three; the difference is the builds' alone, without Python's
    start.

    Raises
    ------
    NotMeasuredError
        perf fails.
    """
    least, most = (
        _run_perf([sys.executable, "-c", _BUILD, mesh, builder, str(count)]) for count in (_LEAST_BUILDS, _MOST_BUILDS)
    )
    return {name: (most[event] - least[event]) / (_MOST_BUILDS - _LEAST_BUILDS) for event, name in EVENTS.items()}


def _run_perf(command: list[str]) -> dict[str, float]:
    """Return the counts of a command by event, or raise `NotMeasuredError`."""
    perf = ["perf", "stat", "-x", ",", "-e", ",".join(EVENTS), "--", *command]
    try:
        ended = subprocess.run(perf, capture_output=True, text=True, timeout=_TIMEOUT_S, check=True)
    except FileNotFoundError:
        raise NotMeasuredError("perf is not installed") from None
    except (OSError, subprocess.SubprocessError) as error:
        raise NotMeasuredError(f"perf stat fails: {error}") from error
    counts = {}
    for line in ended.stderr.splitlines():
        fields = line.split(",")
        if len(fields) > 2 and fields[0].replace(".", "").isdigit():
            counts[fields[2].partition(":")[0]] = float(fields[0])
    if missing := [event for event in EVENTS if event not in counts]:
        raise NotMeasuredError(f"perf does not count {', '.join(missing)} on this machine")
    return counts


def _digest_sources() -> str:
    """Return a digest of the code that is measured: all of it but the rooms that only present."""
    digest = hashlib.sha256()
    package = Path(__file__).resolve().parents[1]
    for folder, pattern in ((package, "**/*.py"), (find_folder("cl"), "**/*.c*")):
        for path in sorted(folder.glob(pattern)):
            name = path.relative_to(folder)
            if name.parts[0] not in _PRESENTING_ROOMS:
                digest.update(f"{name.as_posix()}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()[:_DIGITS]


def _describe(info: DeviceInfo) -> str:
    return f"{info.name}, {info.platform}, driver {info.driver_version}"


def _find_processor() -> str:
    """Return the processor's name; Python knows it on Windows and macOS alone."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
