"""Facts about OpenCL drivers from the file system, without loading any of them.

Finds the libraries of drivers, which no `.icd` file may name, graphics cards that no library serves, and device files
that may not be opened. It draws no conclusions: `doctor/diagnose.py` does. The `.icd` files are in `icd_files.py`.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

_LDCONFIG = ("ldconfig", "/sbin/ldconfig", "/usr/sbin/ldconfig")
_LDCONFIG_TIMEOUT_S = 10


@dataclass(frozen=True)
class Driver:
    """A driver that this module recognises.

    Attributes
    ----------
    stem : str
        The start of the file name of its library.
    vendor : str
        The vendor of the hardware, as in `GPU_VENDORS`; for a CPU driver the name of the driver.
    icd_name : str
        The usual name of its `.icd` file.
    """

    stem: str
    vendor: str
    icd_name: str


KNOWN_DRIVERS = (
    Driver("libnvidia-opencl.so", "NVIDIA", "nvidia.icd"),
    Driver("libamdocl64.so", "AMD", "amdocl64.icd"),
    Driver("libigdrcl.so", "Intel", "intel.icd"),
    Driver("libRusticlOpenCL.so", "Mesa rusticl", "rusticl.icd"),
    Driver("libintelocl.so", "Intel CPU runtime", "intel64.icd"),
    Driver("intelocl64.dll", "Intel CPU runtime", "intel64.icd"),
    Driver("libpocl.so", "PoCL", "pocl.icd"),
)

# PCI vendor ids. Other display controllers (virtual ones, those of server boards) run no OpenCL.
GPU_VENDORS = {0x10DE: "NVIDIA", 0x1002: "AMD", 0x8086: "Intel"}

# PCI base classes: display controller, processing accelerator (AMD's Instinct cards call themselves that).
_GPU_CLASSES = (0x03, 0x12)


@dataclass(frozen=True)
class FoundLibrary:
    """A driver's library on this machine."""

    driver: Driver
    path: Path


@dataclass(frozen=True)
class DeviceFile:
    """An existing device file of a GPU; `may_open` if this user may read and write it."""

    path: Path
    vendor: str
    may_open: bool


def find_libraries(folders: Iterable[Path], cached: Iterable[Path] = ()) -> list[FoundLibrary]:
    """Return the libraries of known drivers, one for each driver.

    Parameters
    ----------
    folders : iterable of Path
        Searched in this order; they need not exist.
    cached : iterable of Path
        Known libraries, for example those of `read_library_cache`; they come before the folders.
    """
    candidates = [*cached]
    for folder in folders:
        for driver in KNOWN_DRIVERS:
            # The shortest name first: the link "libpocl.so.2" outlives an update of "libpocl.so.2.12.0".
            candidates += sorted(folder.glob(f"{driver.stem}*"), key=lambda path: (len(path.name), path.name))
    found: dict[str, FoundLibrary] = {}
    for path in candidates:
        known = match_driver(path.name)
        if known is not None and known.stem not in found and path.exists():
            found[known.stem] = FoundLibrary(known, path)
    return [found[driver.stem] for driver in KNOWN_DRIVERS if driver.stem in found]


def match_driver(library: str) -> Driver | None:
    """Return the known driver of a library, which is given by its name or path."""
    name = Path(library.strip()).name
    return next((driver for driver in KNOWN_DRIVERS if name.startswith(driver.stem)), None)


def usual_folders(environment: Mapping[str, str] = os.environ, prefix: str = sys.prefix) -> list[Path]:
    """Return the folders in which drivers install their libraries."""
    multiarch = f"{platform.machine()}-linux-gnu"
    named = [Path(folder) for folder in environment.get("LD_LIBRARY_PATH", "").split(os.pathsep) if folder]
    fixed = [
        f"/usr/lib/{multiarch}",
        f"/usr/lib/{multiarch}/intel-opencl",
        "/usr/lib64",
        "/usr/lib64/intel-opencl",
        "/usr/lib",
        "/usr/lib/intel-opencl",
        "/usr/local/lib",
        "/usr/local/nvidia/lib64",
        "/usr/lib/wsl/lib",
        "/run/opengl-driver/lib",
        "/opt/rocm/lib",
        "/opt/rocm/opencl/lib",
        f"/opt/amdgpu-pro/lib/{multiarch}",
        "/opt/intel/oneapi/compiler/latest/lib",
        "/opt/intel/oneapi/compiler/latest/linux/lib/x64",
    ]
    if sys.platform == "win32":
        return [*named, Path(prefix) / "Library" / "bin"]
    versioned = sorted(Path("/opt").glob("rocm-*/lib"), reverse=True)
    return [*named, *map(Path, fixed), *versioned, Path(prefix) / "lib"]


def read_library_cache() -> list[Path]:
    """Return the libraries that the dynamic linker knows; empty without an `ldconfig` command."""
    for command in _LDCONFIG:
        try:
            answer = subprocess.run(
                [command, "-p"], capture_output=True, text=True, timeout=_LDCONFIG_TIMEOUT_S, check=False
            )
        except (OSError, subprocess.TimeoutExpired):
            continue
        return parse_library_cache(answer.stdout)
    return []


def parse_library_cache(text: str) -> list[Path]:
    """Return the paths in the output of `ldconfig -p`: one line for each, "<tab>name (kind) => path"."""
    lines = [line for line in text.splitlines() if " => " in line]
    # The kinds of 64-bit systems have "64" in their names; a 32-bit copy of a driver must not come first.
    lines.sort(key=lambda line: "64" not in line.partition(" => ")[0].partition("(")[2])
    return [Path(line.partition(" => ")[2]) for line in lines]


def find_gpus(root: Path = Path("/sys/bus/pci/devices")) -> list[str]:
    """Return the vendor of each GPU on the PCI bus, in the order of the bus."""
    vendors = []
    for folder in sorted(root.glob("*")):
        try:
            vendor = int((folder / "vendor").read_text(), 16)
            base_class = int((folder / "class").read_text(), 16) >> 16
        except (OSError, ValueError):
            continue
        if base_class in _GPU_CLASSES and vendor in GPU_VENDORS:
            vendors.append(GPU_VENDORS[vendor])
    return vendors


def find_device_files(root: Path = Path("/dev")) -> list[DeviceFile]:
    """Return the device files through which drivers reach a GPU."""
    patterns = (
        ("NVIDIA", "nvidiactl"),
        ("NVIDIA", "nvidia-uvm"),
        ("NVIDIA", "nvidia[0-9]*"),
        ("AMD", "kfd"),
        # Shared by the drivers of AMD, Intel and Mesa.
        ("", "dri/renderD*"),
        # The GPU of the Windows host under WSL.
        ("", "dxg"),
    )
    return [
        DeviceFile(path, vendor, os.access(path, os.R_OK | os.W_OK))
        for vendor, pattern in patterns
        for path in sorted(root.glob(pattern))
    ]
