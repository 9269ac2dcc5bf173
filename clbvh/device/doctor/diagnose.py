"""Finds the causes of missing or failing devices.

Returns data and prints nothing. Drivers are touched only in processes of their own (`probe.py`); facts from the file
system come from `drivers.py`, remedies from `advice.py`.
"""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

from ...errors import DeviceError
from ..icd_files import SYSTEM_VENDORS, IcdFile, LoaderRule, find_icd_files
from ..info import DeviceInfo
from ..match import pick_device
from ..pocl_linker import explain_missing_linker
from ..registered_drivers import find_registered_folder, read_rule
from ..select import DEVICE_VARIABLE
from . import drivers
from .advice import (
    ADVICE_FOR_GPU,
    ADVICE_FOR_LISTING,
    advise_cpu_driver,
    advise_device_files,
    advise_failure,
    advise_icd,
    advise_pyopencl,
    advise_unloadable,
)
from .drivers import DeviceFile, FoundLibrary
from .probe import ProbeResult, run_probe
from .register import find_unregistered

Severity = Literal["ok", "note", "problem"]

# A first compilation takes about a second with PoCL; the first use of a GPU after boot can take ten.
PROBE_TIMEOUT_S = 60.0

# Most characters of a compiler's log in a message: a few lines; `Trial.error` has all of it.
_ERROR_LENGTH = 400


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes
    ----------
    check : str
        The check: ``"pyopencl"``, ``"loader"``, ``"driver file"``, ``"driver library"``,
        ``"device file"``, ``"platform"``, ``"device"``, ``"hardware"`` or ``"choice"``.
    severity : {"ok", "note", "problem"}
        A note may be intended; a problem prevents something from working.
    message : str
        The fact that was found.
    advice : tuple of str
        Remedies, line by line; a line that begins with ``$`` is a command.
    """

    check: str
    severity: Severity
    message: str
    advice: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the finding as JSON has it."""
        return dict(vars(self))


@dataclass(frozen=True)
class Trial:
    """The result of a small kernel on one device; `error` is empty if the result was right."""

    device: DeviceInfo
    error: str
    wall_s: float

    @property
    def works(self) -> bool:
        """Whether the kernel compiled, ran and computed the right numbers."""
        return not self.error


@dataclass(frozen=True)
class Diagnosis:
    """All findings, in the order in which an OpenCL program meets them, and the trial of each device."""

    findings: tuple[Finding, ...]
    trials: tuple[Trial, ...]

    @property
    def works(self) -> bool:
        """Whether at least one device works."""
        return any(trial.works for trial in self.trials)


def diagnose(timeout_s: float = PROBE_TIMEOUT_S) -> Diagnosis:
    """Check everything from the Python package down to a kernel on each device.

    Parameters
    ----------
    timeout_s : float
        Time limit for each answer of a driver.
    """
    rule = read_rule()
    listing = run_probe("list", timeout_s=timeout_s)
    findings = check_pyopencl(listing, rule)

    # Driver files matter only where the loader works with files.
    on_linux = sys.platform == "linux"
    icd_files = find_icd_files(rule) if on_linux else []
    if on_linux:
        findings += check_loader_rule(rule, icd_files)
        loaded = [run_probe("load", icd.loadable_name(rule), timeout_s=timeout_s) for icd in icd_files]
        findings += check_icd_files(icd_files, loaded)
        libraries = drivers.find_libraries(drivers.usual_folders(), drivers.read_library_cache())
        findings += check_libraries(libraries, icd_files)
        findings += check_device_files(drivers.find_device_files())

    findings += check_listing(listing)
    devices = read_devices(listing)
    trials = []
    for device in devices:
        result = run_probe("try", str(device.number), timeout_s=timeout_s)
        trials.append(Trial(device, result.failure, result.wall_s))
        findings.append(check_trial(trials[-1], result.log))

    if on_linux:
        findings += check_hardware(drivers.find_gpus(), [trial.device for trial in trials if trial.works])
    if not any(trial.works for trial in trials):
        message = "no device works: clbvh needs at least one OpenCL driver"
        findings.append(Finding("device", "problem", message, advise_cpu_driver(rule, icd_files)))
    findings += check_choice(trials)
    return Diagnosis(tuple(findings), tuple(trials))


def check_pyopencl(listing: ProbeResult, rule: LoaderRule) -> list[Finding]:
    """Check whether pyopencl can be imported, and which loader it uses."""
    if listing.answer.get("pyopencl"):
        loader = listing.answer.get("loader") or "the system's loader"
        return [
            Finding("pyopencl", "ok", f"pyopencl {listing.answer['pyopencl']} with {loader}"),
        ]
    if "error" not in listing.answer:
        # It crashed or hung: `check_listing` reports that.
        return []
    advice = advise_pyopencl(listing.failure, rule.bundled is not None)
    return [Finding("pyopencl", "problem", f"pyopencl cannot be imported: {listing.failure}", advice)]


def check_loader_rule(rule: LoaderRule, icd_files: Sequence[IcdFile]) -> list[Finding]:
    """Check where the loader looks for drivers."""
    if rule.single:
        return [
            Finding(
                "loader",
                "note",
                f"{rule.variable}={rule.single} is no folder, so the loader takes it for the only driver",
                ("to have all drivers back:", f"$ unset {rule.variable}"),
            )
        ]
    because = f" (set by {rule.variable})" if rule.variable else ""
    where = " and ".join(str(folder) for folder in rule.folders)
    findings = [Finding("loader", "ok", f"the loader looks for *.icd files in {where}{because}")]
    if not icd_files:
        findings.append(Finding("driver file", "problem", "no driver is registered: there is no *.icd file there"))
    for folder in (SYSTEM_VENDORS, find_registered_folder()):
        hidden = [path.name for path in sorted(folder.glob("*.icd"))]
        if rule.variable and hidden and folder not in rule.folders:
            message = f"{rule.variable} hides the drivers of {folder}: {', '.join(hidden)}"
            advice = ("if that is not intended:", f"$ unset {rule.variable}")
            findings.append(Finding("loader", "note", message, advice))
    return findings


def check_icd_files(icd_files: Sequence[IcdFile], loaded: Sequence[ProbeResult]) -> list[Finding]:
    """Check for each registered driver whether its library can be loaded.

    Parameters
    ----------
    icd_files : sequence of IcdFile
        The files.
    loaded : sequence of ProbeResult
        For each file, the result of loading its library.
    """
    findings = []
    for icd, result in zip(icd_files, loaded, strict=True):
        if not icd.library:
            advice = ("remove the file, or write the path of the driver's library into it",)
            findings.append(Finding("driver file", "problem", f"{icd.path} cannot be read or is empty", advice))
        elif result.failure:
            message = f"{icd.path} names '{icd.library}', which cannot be loaded: {result.failure}"
            findings.append(Finding("driver file", "problem", message, advise_unloadable(icd)))
        else:
            findings.append(Finding("driver file", "ok", f"{icd.path} names {icd.library}"))
    return findings


def check_libraries(libraries: Sequence[FoundLibrary], icd_files: Sequence[IcdFile]) -> list[Finding]:
    """Find drivers that are installed but that no `.icd` file names, as happens in containers."""
    findings = []
    for library in find_unregistered(libraries, icd_files):
        message = f"{library.path} is a driver ({library.driver.vendor}) that no *.icd file names"
        # A driver for the CPU, or Mesa's beside the vendor's own, is often left out on purpose.
        severity: Severity = "problem" if library.driver.vendor in drivers.GPU_VENDORS.values() else "note"
        findings.append(Finding("driver library", severity, message, advise_icd(library)))
    return findings


def check_device_files(device_files: Sequence[DeviceFile]) -> list[Finding]:
    """Find GPUs that this user may not open."""
    refused = [file for file in device_files if not file.may_open]
    if not refused:
        return []
    names = ", ".join(str(file.path) for file in refused)
    return [Finding("device file", "note", f"you may not read and write {names}", advise_device_files(refused))]


def check_listing(listing: ProbeResult) -> list[Finding]:
    """Report platforms that were left out, and a listing that did not finish."""
    findings = [
        Finding("platform", "problem", problem, advise_failure(problem + listing.log))
        for problem in listing.answer.get("problems", ())
        if problem != explain_missing_linker()  # the trial of the device says so
    ]
    if listing.failure and not listing.answer:
        message = f"the process that asks all drivers for their devices {listing.failure}"
        findings.append(Finding("platform", "problem", message, ADVICE_FOR_LISTING))
    elif "devices" in listing.answer and not listing.answer["devices"]:
        findings.append(Finding("platform", "problem", "no driver offers a device"))
    return findings


def check_trial(trial: Trial, log: str = "") -> Finding:
    """Check the result of the small kernel on one device."""
    if trial.works:
        return Finding("device", "ok", f"{trial.device} computes correctly ({trial.wall_s:.1f} s)")
    said = textwrap.shorten(trial.error, _ERROR_LENGTH, placeholder=" ...")
    advice = advise_failure(f"{trial.error}\n{log}", trial.device)
    return Finding("device", "problem", f"{trial.device} does not work: {said}", advice)


def check_hardware(gpus: Sequence[str], working: Sequence[DeviceInfo]) -> list[Finding]:
    """Find GPUs on the bus that no working device belongs to.

    Parameters
    ----------
    gpus : sequence of str
        Vendors, as `drivers.find_gpus` names them.
    working : sequence of DeviceInfo
        The devices that passed their trial.
    """
    served = " ".join(f"{info.vendor} {info.name} {info.platform}" for info in working if info.kind != "cpu").lower()
    findings = []
    for vendor in dict.fromkeys(gpus):
        # AMD's own driver spells its vendor's name out.
        if vendor.lower() in served or (vendor == "AMD" and "advanced micro devices" in served):
            continue
        message = f"there is a GPU of {vendor} in this machine, and no OpenCL device that uses it"
        findings.append(Finding("hardware", "note", message, ADVICE_FOR_GPU[vendor]))
    return findings


def check_choice(trials: Sequence[Trial]) -> list[Finding]:
    """Check whether the device that would be used works."""
    if not trials:
        return []
    spec = os.environ.get(DEVICE_VARIABLE, "").strip() or None
    asked_by = f" (asked for by {DEVICE_VARIABLE})" if spec else ""
    devices = [trial.device for trial in trials]
    try:
        chosen = pick_device(devices, spec, asked_by)
    except DeviceError as error:
        return [Finding("choice", "problem", str(error), (f"$ unset {DEVICE_VARIABLE}",))]
    trial = trials[devices.index(chosen)]
    if trial.works:
        return [Finding("choice", "ok", f"clbvh uses {chosen}{asked_by} unless --device says otherwise")]
    advice = tuple(f"$ export {DEVICE_VARIABLE}={other.device.number}" for other in trials if other.works)[:1]
    return [Finding("choice", "problem", f"clbvh would use {chosen}{asked_by}, which does not work", advice)]


def read_devices(listing: ProbeResult) -> list[DeviceInfo]:
    """Return the devices that a probe listed, without their handles, which stayed in that process."""
    known = {field.name for field in fields(DeviceInfo)}
    return [
        DeviceInfo(**{name: value for name, value in facts.items() if name in known})
        for facts in listing.answer.get("devices", ())
    ]
