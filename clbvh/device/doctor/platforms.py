"""The CPU drivers of each platform: what the installation brings, and the commands that bring the rest.

`clbvh doctor` prints the commands of its own platform; a test compares the table in docs/devices.md with this one.
"""

from __future__ import annotations

import platform
import sys
from dataclasses import dataclass


@dataclass(frozen=True)
class Platform:
    """A platform that clbvh can be installed on.

    Attributes
    ----------
    name : str
    system : str
        As in `sys.platform`.
    machines : tuple of str
        As `platform.machine` returns them, in lower case.
    included : str
        The OpenCL devices that work without another step.
    commands : tuple of str
        Each of them brings a driver for the CPU.
    """

    name: str
    system: str
    machines: tuple[str, ...]
    included: str
    commands: tuple[str, ...]


_CONDA = "conda install -c conda-forge pyopencl pocl"

PLATFORMS = (
    Platform(
        "Linux x86-64",
        "linux",
        ("x86_64", "amd64"),
        "the CPU: PoCL 3.0 comes with the installation",
        ("pip install --force-reinstall pocl-binary-distribution", "sudo apt install pocl-opencl-icd", _CONDA),
    ),
    Platform(
        "Linux aarch64",
        "linux",
        ("aarch64", "arm64"),
        "none: install a driver",
        ("sudo apt install pocl-opencl-icd", _CONDA),
    ),
    Platform(
        "macOS arm64",
        "darwin",
        ("arm64",),
        "the GPU, by Apple's own OpenCL; no CPU",
        (_CONDA,),
    ),
    Platform(
        "Windows x86-64",
        "win32",
        ("amd64", "x86_64"),
        "a GPU whose driver is installed; no CPU",
        (
            "pip install intel-opencl-rt intel-cmplr-lib-rt && clbvh doctor --fix",
            # Of conda-forge's packages of PoCL, this one has a build for Windows.
            "conda install -c conda-forge pyopencl pocl-cpu-minimal",
        ),
    ),
)


def find_platform(system: str = sys.platform, machine: str | None = None) -> Platform | None:
    """Return the platform of this machine; None if it is not in the table."""
    machine = (platform.machine() if machine is None else machine).lower()
    return next((known for known in PLATFORMS if known.system == system and machine in known.machines), None)


def find_commands(system: str = sys.platform, machine: str | None = None) -> tuple[str, ...]:
    """Return the commands that bring a driver for the CPU of this machine; conda's, where the table has none."""
    known = find_platform(system, machine)
    return known.commands if known else (_CONDA,)
