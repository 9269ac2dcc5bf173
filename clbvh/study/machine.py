"""The machine of a study: processor, memory, versions and drivers, and what is missing.

Samples are only compared with samples of the same machine and the same versions; a digest of these facts says so.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from ..device.info import DeviceInfo
from ..device.select import choose_device, survey_devices
from ..errors import DeviceError
from ..support.atomic_file import write_atomically
from ..support.host_threads import usable_cores
from ..support.resources import find_folder

FILE_NAME = "machines.json"

# Packages whose version can change a figure.
_MEASURED = ("clbvh", "numpy", "numba", "llvmlite", "pyopencl", "trimesh", "rtree", "open3d", "embreex")
_PRESENTING_ROOMS = ("cli", "conformance", "study")
_DIGITS = 12
_GIB = 1 << 30


@dataclass(frozen=True)
class Machine:
    """The facts of a machine.

    Attributes
    ----------
    facts : dict of str to str
        By the name that the page shows.
    devices : tuple of DeviceInfo
        All usable OpenCL devices.
    device : DeviceInfo or None
        The one that is measured; None if there is none.
    problem : str
        Why there is no device.
    """

    facts: dict[str, str]
    devices: tuple[DeviceInfo, ...]
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
    problem = ""
    devices: tuple[DeviceInfo, ...] = ()
    chosen: DeviceInfo | None = None
    try:
        devices = tuple(info for info in survey_devices().devices if info.is_available)
        chosen = choose_device(device)
    except DeviceError as error:
        if device is not None:
            raise
        problem = str(error)
    facts = {
        "processor": _find_processor(),
        "cores": str(usable_cores()),
        "memory": _find_memory(),
        "system": f"{platform.system()} {platform.release()}, {platform.machine()}",
        "python": platform.python_version(),
        **{name: version for name in _MEASURED if (version := find_version(name)) is not None},
        "sources": _digest_sources(),
        "device": "none" if chosen is None else _describe(chosen),
        "device kind": "missing" if chosen is None else chosen.kind,
        **{f"device {info.number}": _describe(info) for info in devices},
    }
    return Machine(facts, devices, chosen, problem)


def find_version(package: str) -> str | None:
    """Return the version of an installed package, None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def keep_machine(folder: Path, machine: Machine) -> list[str]:
    """Keep the facts of a machine beside its samples.

    Returns
    -------
    list of str
        What differs from the machine of the study before in this folder, one sentence each; empty if nothing does.
    """
    path = folder / FILE_NAME
    kept = read_machines(folder)
    changes: list[str] = []
    if kept and machine.digest not in kept:
        *_, latest = kept.values()
        changes = list(_compare(latest, machine.facts))
    # The latest one stands last.
    kept.pop(machine.digest, None)
    kept[machine.digest] = machine.facts
    write_atomically(path, lambda file: file.write(json.dumps(kept, indent=2).encode()))
    return changes


def read_machines(folder: Path) -> dict[str, dict[str, str]]:
    """Return the facts of the machines of a folder by their digests, the latest last; empty for a damaged file."""
    try:
        kept: Any = json.loads((folder / FILE_NAME).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(kept, dict) or not all(isinstance(facts, dict) for facts in kept.values()):
        return {}
    return kept


def load_average() -> float | None:
    """Return the mean number of running processes in the last minute, None where the system does not say."""
    try:
        return round(os.getloadavg()[0], 2)
    except (AttributeError, OSError):
        return None


def _compare(before: dict[str, str], now: dict[str, str]) -> Iterator[str]:
    for name in {**before, **now}:
        if before.get(name) != now.get(name):
            yield f"{name} was {before.get(name, 'missing')}, and is {now.get(name, 'missing')}"


@cache
def _digest_sources() -> str:
    """Return a digest of the code that is measured: all of it but the rooms that only present."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for folder, pattern in ((package, "*.py"), (find_folder("cl"), "*.cl")):
        for path in sorted(folder.rglob(pattern)):
            name = path.relative_to(folder)
            if folder != package or name.parts[0] not in _PRESENTING_ROOMS:
                digest.update(f"{name}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()[:_DIGITS]


def _describe(info: DeviceInfo) -> str:
    return f"{info.name}, {info.platform}, driver {info.driver_version}"


def _find_processor() -> str:
    """Return the processor's name."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _find_memory() -> str:
    try:
        size = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return "unknown"
    return f"{size / _GIB:.0f} GiB"
