"""The doctor: causes of missing or failing devices, remedies, and the registration of drivers that nothing names.

Returns data and prints nothing. Where the host works, OpenCL may be missing; a driver that is there and fails is a
problem all the same. Kernels run, and drivers are touched, only in processes of their own (`probe.py`).
"""

from __future__ import annotations

import os
import platform
import re
import sys
import tempfile
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

from ..errors import ConfigError, DeviceError, KernelBuildError
from .driver_files import DriverFile, find_folders, find_naming_variable, find_registered_folder, read_driver_files
from .host.info import describe_host
from .host.library import fits_sources, open_library
from .info import HOST_PLATFORM, DeviceInfo
from .probe import ProbeResult, run_probe
from .select import NO_DRIVER

# Most characters of a compiler's log in a message: a few lines; `Trial.error` has all of it.
_ERROR_LENGTH = 400

# Beginnings of the names of drivers' libraries, and the usual names of their driver files.
KNOWN_DRIVERS = {
    "libnvidia-opencl.so": "nvidia.icd",
    "libamdocl64.so": "amdocl64.icd",
    "libigdrcl.so": "intel.icd",
    "libRusticlOpenCL.so": "rusticl.icd",
    "libintelocl.so": "intel64.icd",
    "libpocl.so": "pocl.icd",
}
# Where drivers install their libraries, beside the environment's own folder.
_LIBRARY_FOLDERS = f"""
    /usr/lib/{platform.machine()}-linux-gnu /usr/lib64 /usr/lib /usr/local/lib
    /usr/lib/{platform.machine()}-linux-gnu/intel-opencl /usr/lib64/intel-opencl /usr/lib/intel-opencl
    /usr/local/nvidia/lib64 /usr/lib/wsl/lib /run/opengl-driver/lib /opt/rocm/lib /opt/intel/oneapi/compiler/latest/lib
""".split()

# Vendors of GPUs by their PCI vendor id, and the command that installs their driver.
_GPUS = {
    0x10DE: ("NVIDIA", "$ sudo apt install libnvidia-compute-VERSION    # VERSION: that of the driver"),
    0x1002: ("AMD", "$ sudo apt install rocm-opencl-runtime    # from AMD, or mesa-opencl-icd; join the group render"),
    0x8086: ("Intel", "$ sudo apt install intel-opencl-icd    # and join the group render"),
}
# PCI base classes: display controller, processing accelerator (AMD's Instinct cards call themselves that).
_GPU_CLASSES = ("0x03", "0x12")

# Advice by the words of a failure: the first that fits.
_ADVICE = {
    # The LLVM inside PoCL calls a newer processor "generic", which the compiler then refuses (pocl/pocl issue 1049).
    "unknown target CPU|does not recognize your cpu|Portable Computing Language.*SIGILL": (
        "this PoCL is older than the CPU: use a newer one, as that of conda-forge, or name a CPU that it knows",
        "$ export POCL_LLVM_CPU_NAME=x86-64-v3",
    ),
    "cannot compile kernels without": ("$ sudo apt install gcc    # or do without this driver: the host needs none",),
    "Portable Computing Language.*offers no device|No space left|Permission denied": (
        "the driver needs a folder for kernels with room to write: name another place",
        "$ export POCL_CACHE_DIR=$(mktemp -d) CUDA_CACHE_PATH=$(mktemp -d)",
    ),
    "rusticl.*offers no device": ("name the GPU drivers that it serves", "$ export RUSTICL_ENABLE=radeonsi"),
    "did not answer": ("the driver hangs: is the device busy? Else restart the driver or the machine",),
    "lib(imf|svml|irng|intlc)": ("Intel's runtime needs its compiler's libraries", "$ pip install intel-cmplr-lib-rt"),
    "which cannot be loaded|cannot be read": ("reinstall the driver and the libraries it needs, or delete the file",),
    "No module named 'pyopencl'": ("$ pip install pyopencl",),
    "pyopencl cannot be imported": ("$ pip install --force-reinstall --only-binary :all: pyopencl",),
    r"\(host\)|do not fit": ("$ pip install --force-reinstall --no-deps clbvh",),
    "asks all drivers": ("try the drivers one at a time", "$ OCL_ICD_VENDORS=/path/of/one/driver.icd clbvh devices"),
    "": ("update the driver of this device; until then choose another one with --device",),
}

Severity = Literal["ok", "note", "problem"]


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes
    ----------
    check : str
        The check: ``"host"``, ``"pyopencl"``, ``"loader"``, ``"driver file"``, ``"driver library"``,
        ``"platform"``, ``"device"`` or ``"hardware"``.
    severity : {"ok", "note", "problem"}
        A note may be intended; a problem prevents something from working.
    message : str
    advice : tuple of str
        Remedies, line by line; a line that begins with ``$`` is a command.
    """

    check: str
    severity: Severity
    message: str
    advice: tuple[str, ...] = ()


class Trial(NamedTuple):
    """The result of a small sort on one device; `error` is empty if it was right, `log` is the driver's output."""

    device: DeviceInfo
    error: str
    log: str


@dataclass(frozen=True)
class Step:
    """A driver file to write, with the devices that work; or a driver to leave alone, with the reason."""

    action: Literal["write", "leave"]
    path: Path
    library: str
    reason: str


def advise(failure: str) -> tuple[str, ...]:
    """Return advice for a failure, by the words of the driver and its compiler."""
    return next(advice for words, advice in _ADVICE.items() if re.search(words, failure, re.DOTALL))


def diagnose(timeout_s: float) -> tuple[list[Finding], list[Trial]]:
    """Check the host, and then everything from the Python package down to kernels on each OpenCL device.

    Returns
    -------
    findings : list of Finding
        In the order in which a program meets them.
    trials : list of Trial
        One for each device, the host first.
    """
    host, trials = _try_host(timeout_s)
    # Without the host, whatever OpenCL lacks is a fault.
    lack: Severity = "note" if host.severity == "ok" else "problem"
    listing, opencl_trials = _try_opencl(timeout_s)
    findings = [host]
    if version := listing.answer.get("pyopencl"):
        findings.append(Finding("pyopencl", "ok", f"pyopencl {version}"))
    elif listing.answer:
        findings.append(_report("pyopencl", f"pyopencl cannot be imported: {listing.failure}", severity=lack))
    if sys.platform == "linux":  # elsewhere the loader works without files
        findings += _check_files(timeout_s)

    problems = list(listing.answer.get("problems", ()))
    if NO_DRIVER in problems:
        findings.append(Finding("platform", lack, NO_DRIVER))
    if not listing.answer:
        problems.append(f"the process that asks all drivers for their devices {listing.failure}")
    findings += [_report("platform", problem) for problem in problems if problem not in (NO_DRIVER, host.message)]
    findings += map(_judge, opencl_trials)
    findings += check_gpus([trial.device for trial in opencl_trials if not trial.error])
    return findings, trials + opencl_trials


def _try_host(timeout_s: float) -> tuple[Finding, list[Trial]]:
    """Check the library of compiled kernels, and try it."""
    try:
        library, device = open_library(), describe_host()
    except (DeviceError, KernelBuildError) as error:
        return Finding("host", "problem", str(error)), []  # it says what to do
    if not fits_sources(library.path):
        return _report("host", f"the compiled kernels in {library.path} do not fit their sources"), []
    result = run_probe("try", HOST_PLATFORM, timeout_s=timeout_s)
    trial = Trial(device, result.failure, result.log)
    if result.failure:
        return replace(_judge(trial), check="host"), [trial]
    levels = f"{library.path} has code for {', '.join(library.levels)}, and {library.level} runs here"
    return Finding("host", "ok", f"{device} computes correctly: {levels}"), [trial]


def _try_opencl(timeout_s: float, environment: Mapping[str, str] | None = None) -> tuple[ProbeResult, list[Trial]]:
    """Return the list of all devices, as a process of its own has it, and the trial of each that is not the host."""
    listing = run_probe("list", timeout_s=timeout_s, environment=environment)
    trials = []
    for facts in listing.answer.get("devices", ()):
        del facts["layout"]
        if not (device := DeviceInfo(**facts)).is_host:
            result = run_probe("try", str(device.number), timeout_s=timeout_s, environment=environment)
            trials.append(Trial(device, result.failure, result.log))
    return listing, trials


def _judge(trial: Trial) -> Finding:
    device, error, log = trial
    if not error:
        return Finding("device", "ok", f"{device} computes correctly")
    said = textwrap.shorten(error, _ERROR_LENGTH, placeholder=" ...")
    return _report("device", f"{device} does not work: {said}", f"{error}\n{log}")


def _report(check: str, message: str, log: str = "", severity: Severity = "problem") -> Finding:
    return Finding(check, severity, message, advise(f"{message}\n{log}"))


def _check_files(timeout_s: float) -> Iterator[Finding]:
    """Check where the loader looks for drivers, whether it can load them, and whether it finds all."""
    files = read_driver_files()
    if variable := find_naming_variable():
        message = f"{variable}={os.environ[variable]} names the drivers: no driver file elsewhere counts"
        yield Finding("loader", "note", message, ("if that is not intended:", f"$ unset {variable}"))
    else:
        yield Finding("loader", "ok", f"the loader looks for *.icd files in {' and '.join(map(str, find_folders()))}")
    for file in files:
        if not file.library:
            yield _report("driver file", f"{file.path} cannot be read or is empty")
        elif failure := run_probe("load", file.library, timeout_s=timeout_s).failure:
            yield _report("driver file", f"{file.path} names '{file.library}', which cannot be loaded: {failure}")
        else:
            yield Finding("driver file", "ok", f"{file.path} names {file.library}")
    for library, _ in find_unregistered(files):
        # A driver for the CPU, or Mesa's beside the vendor's own, is often left out on purpose.
        advice = ("try it, and register it for clbvh, in your own folder:", "$ clbvh doctor --fix")
        yield Finding("driver library", "note", f"{library} is a driver that no *.icd file names", advice)


def check_gpus(working: Iterable[DeviceInfo], root: Path = Path("/sys/bus/pci/devices")) -> Iterator[Finding]:
    """Find GPUs on the PCI bus that no working device belongs to; none where the system does not tell."""
    gpus = [path for path in root.glob("*/class") if path.read_text().startswith(_GPU_CLASSES)]
    vendors = {int(path.with_name("vendor").read_text(), 16) for path in gpus}
    served = " ".join(f"{info.vendor} {info.name} {info.platform}" for info in working if info.kind != "cpu").lower()
    for number, (vendor, command) in _GPUS.items():
        if number in vendors and vendor.lower() not in served:
            message = f"there is a GPU of {vendor} in this machine, and no OpenCL device that uses it"
            yield Finding("hardware", "note", message, (command,))


def find_unregistered(files: Iterable[DriverFile]) -> list[tuple[Path, str]]:
    """Return the libraries of known drivers that no driver file names, and the usual names of their driver files."""
    named = " ".join(name for file in files for name in file.names)
    variable = [folder for folder in os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep) if folder]
    folders = [*variable, *_LIBRARY_FOLDERS, f"{sys.prefix}/lib"]
    found = []
    for stem, icd_name in KNOWN_DRIVERS.items():
        # The first of a folder: the link "libpocl.so.2" outlives an update of "libpocl.so.2.12.0".
        paths = [path for folder in folders for path in sorted(Path(folder).glob(f"{stem}*"))]
        if paths and stem not in named:
            found.append((paths[0], icd_name))
    return found


def register_drivers(timeout_s: float, *, dry_run: bool) -> list[Step]:
    """Try the drivers that no driver file names, each alone, and register those that work in clbvh's own folder.

    A file there whose library is gone counts for nothing. Nothing is written with `dry_run`.

    Raises
    ------
    ConfigError
        A variable names the drivers of this process, so the folder is not read; or it cannot be written to.
    """
    if variable := find_naming_variable():
        raise ConfigError(f"{variable} is set, so clbvh's own drivers are not read: unset it, then run this again")
    own, steps = find_registered_folder(), []
    files = [file for file in read_driver_files() if file.path.parent != own or Path(file.library).is_file()]
    for library, icd_name in find_unregistered(files):
        working, failure = try_library(str(library), timeout_s)
        steps.append(Step("write" if working else "leave", own / icd_name, str(library), ", ".join(working) or failure))
        if working and not dry_run:
            try:
                own.mkdir(parents=True, exist_ok=True)
                (own / icd_name).write_text(f"{library}\n")
            except OSError as error:
                raise ConfigError(f"{own}: cannot be written to ({error.strerror}): check the folder") from error
    return steps


def try_library(library: str, timeout_s: float) -> tuple[list[str], str]:
    """Return the names of the devices of a driver that compute correctly, and the last failure."""
    if failure := run_probe("load", library, timeout_s=timeout_s).failure:
        return [], " ".join([f"{failure}:", *advise(f"{library}, which cannot be loaded: {failure}")])
    with tempfile.TemporaryDirectory(prefix="clbvh-drivers-") as folder:
        icd = Path(folder) / "only.icd"
        icd.write_text(f"{library}\n")
        # A file, not its folder: the loader takes it for the only driver.
        environment = {"OCL_ICD_VENDORS": str(icd)}
        listing, trials = _try_opencl(timeout_s, environment)
    working = [trial.device.name for trial in trials if not trial.error]
    failures = [f"{trial.device.name}: {trial.error}" for trial in trials if trial.error]
    reasons = [listing.failure, *listing.answer.get("problems", ()), *failures, "it offers no device"]
    return working, next(filter(None, reasons))
