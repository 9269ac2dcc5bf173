"""Advice: the sentences and commands under the findings of `doctor/diagnose.py`.

Each function takes facts and returns lines; a line that begins with ``$`` is a command for a shell. No function touches
a driver.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from ..icd_files import SYSTEM_VENDORS, IcdFile, LoaderRule
from ..info import DeviceInfo
from .drivers import DeviceFile, FoundLibrary
from .platforms import find_commands

Advice = tuple[str, ...]

# Major version of PoCL in the last release of the PyPI package `pocl-binary-distribution`.
_PYPI_POCL_MAJOR = 3

ADVICE_FOR_LISTING: Advice = (
    "one of the drivers causes this: try them one at a time to find it",
    "$ OCL_ICD_VENDORS=/path/of/one/driver.icd clbvh devices",
)

ADVICE_FOR_GPU: dict[str, Advice] = {
    "NVIDIA": (
        "its driver brings OpenCL; if `nvidia-smi` works, only the part for OpenCL is missing:",
        "$ sudo apt install libnvidia-compute-VERSION    # VERSION: that of the driver",
        "in a container: start it with `--gpus all -e NVIDIA_DRIVER_CAPABILITIES=compute,utility`",
    ),
    "AMD": (
        "install OpenCL from ROCm, or Mesa's rusticl for cards that ROCm does not support",
        "$ sudo apt install rocm-opencl-runtime    # from AMD's repository",
        "in a container: pass /dev/kfd and /dev/dri on with `--device`",
    ),
    "Intel": (
        "install Intel's compute runtime",
        "$ sudo apt install intel-opencl-icd",
        "in a container: pass /dev/dri on with `--device`",
    ),
}


def advise_pyopencl(failure: str, has_bundled_loader: bool) -> Advice:
    """Return advice for a pyopencl that cannot be imported."""
    reinstall = "$ pip install --force-reinstall --only-binary :all: pyopencl"
    if "libOpenCL" in failure and not has_bundled_loader:
        return (
            "this pyopencl has no loader of its own: install the system's, or the wheel, which brings one",
            "$ sudo apt install ocl-icd-libopencl1",
            reinstall,
        )
    return (reinstall,)


def advise_icd(library: FoundLibrary) -> Advice:
    """Return the commands that register a driver, for anyone and for an administrator."""
    quoted = shlex.quote(str(library.path))
    return (
        "try it, and register it for clbvh, in your own folder:",
        "$ clbvh doctor --fix",
        "or for all programs of this machine:",
        f"$ sudo mkdir -p {SYSTEM_VENDORS} && echo {quoted} | sudo tee {SYSTEM_VENDORS}/{library.driver.icd_name}",
    )


def advise_device_files(refused: Sequence[DeviceFile]) -> Advice:
    """Return advice for device files without permission."""
    if all(file.vendor == "NVIDIA" for file in refused):
        return ("in a container: start it with the GPU (`docker run --gpus all`); else ask your administrator",)
    return (
        "join the groups that own the files, then log in again; in a container, add `--group-add` for them",
        '$ sudo usermod -aG render,video "$USER"',
    )


def advise_failure(text: str, device: DeviceInfo | None = None) -> Advice:
    """Return advice for a failure, by the messages of the driver and its compiler.

    Parameters
    ----------
    text : str
        The error and the whole output.
    device : DeviceInfo, optional
        The device that failed.
    """
    is_pocl = device is not None and "pocl" in f"{device.platform_version} {device.version}".lower()
    # pocl/pocl issue 1049: the LLVM inside PoCL calls a newer processor "generic", which the compiler then refuses. A
    # wrong guess ends in an instruction that the processor does not have.
    if re.search(r"unknown target CPU|does not recognize your cpu", text) or (is_pocl and "SIGILL" in text):
        return (
            "this PoCL is older than the CPU, and its compiler does not know it: use a newer PoCL",
            *_newer_pocl(device),
            "or, if it is newer than 3.0 already, have it compile for a CPU that it knows",
            "$ export POCL_LLVM_CPU_NAME=x86-64-v3",
        )
    if "cannot compile kernels without" in text:
        return (
            "on Debian and Ubuntu, as root; `gcc` brings the same",
            "$ apt-get install binutils libc6-dev libgcc-12-dev",
            "or another driver, which needs no linker",
            "$ pip install intel-opencl-rt intel-cmplr-lib-rt && clbvh doctor --fix",
        )
    if "Portable Computing Language" in text and "offers no device" in text:
        return (
            "PoCL needs a folder that it can write to; without one it offers no device",
            "$ export POCL_CACHE_DIR=$(mktemp -d)",
            "and POCL_DEVICES, if set, must name devices that it has:",
            "$ unset POCL_DEVICES",
        )
    if "rusticl" in text and "offers no device" in text:
        return (
            "rusticl serves only the GPU drivers that RUSTICL_ENABLE names, for example",
            "$ export RUSTICL_ENABLE=radeonsi",
        )
    if "did not answer" in text:
        return ("the driver hangs: is the device busy with other work? Else restart the driver or the machine",)
    if "No space left" in text or "Permission denied" in text:
        return (
            "the driver keeps compiled kernels in the home folder: make room there, or name another place",
            "$ export POCL_CACHE_DIR=$(mktemp -d) CUDA_CACHE_PATH=$(mktemp -d)",
        )
    if is_pocl:
        number = 0 if device is None else device.number
        return (
            "let PoCL say more:",
            f"$ POCL_DEBUG=err {shlex.quote(sys.executable)} -m clbvh.device.doctor.probe try {number}",
            "a newer PoCL may help:",
            *_newer_pocl(device),
        )
    return ("update the driver of this device; until then choose another one with --device",)


def advise_cpu_driver(rule: LoaderRule, icd_files: Sequence[IcdFile]) -> Advice:
    """Return advice that gives any machine a device: a driver that needs only a CPU."""
    if any("pocl" in f"{icd.path.name} {icd.library}".lower() for icd in icd_files):
        return ("PoCL, which needs no GPU, is registered: see above for its problem",)
    if rule.single and rule.bundled is not None and (rule.bundled / "pocl.icd").is_file():
        return (f"{rule.variable} hides the PoCL that is installed:", f"$ unset {rule.variable}")
    commands = [f"$ {command}" for command in find_commands()]
    return ("a driver for the CPU needs no GPU; any of these brings one:", *commands)


def advise_unloadable(icd: IcdFile) -> Advice:
    """Return advice for a driver file whose library cannot be loaded."""
    if "/" in icd.library and not Path(icd.library).exists():
        return ("the driver was removed or moved: reinstall it, or delete the file",)
    return (
        "if another library is missing, install that one",
        "if the driver lies outside the usual folders, write its full path into the file",
    )


def _newer_pocl(device: DeviceInfo | None) -> Advice:
    """Return the commands that install a newer PoCL than the one of `device`."""
    commands: Advice = (
        "$ conda install -c conda-forge pyopencl pocl",
        "$ sudo apt install pocl-opencl-icd    # on a recent release of the system",
    )
    if 0 <= _read_major(device) < _PYPI_POCL_MAJOR:
        commands = ("$ pip install --force-reinstall pocl-binary-distribution", *commands)
    return commands


def _read_major(device: DeviceInfo | None) -> int:
    """Return the major version of a device's driver, -1 if unknown."""
    match = re.match(r"\d+", device.driver_version) if device is not None else None
    return int(match[0]) if match else -1
