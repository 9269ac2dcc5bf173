"""`clbvh doctor`: the host device and the drivers: what works, the causes of what does not, and remedies."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from . import options
from .tables import print_json

if TYPE_CHECKING:
    from ..device.doctor import Finding

_COLOURS = {"ok": "green", "note": "yellow", "problem": "red"}
_INDENT = " " * 8

# A first compilation takes about a second with PoCL; the first use of a GPU after boot can take ten.
_TIMEOUT_S = 60.0
_LEAST_TIMEOUT_S = 1


def doctor(
    *,
    as_json: options.AsJson = False,
    timeout_s: Annotated[float, Parameter(name="--timeout", metavar="SECONDS", show_default=True)] = _TIMEOUT_S,
    conformance: bool = False,
    fix: bool = False,
    dry_run: bool = False,
    device: Annotated[str | None, Parameter(metavar="DEVICE")] = None,
    mesh: Annotated[list[str] | None, Parameter(metavar="NAME")] = None,
) -> None:
    """Check the host device, and OpenCL from the loader to kernels; print faults and remedies.

    Parameters
    ----------
    timeout_s
        Time limit for each answer of a driver, at least 1.
    conformance
        Compare one device's answers with the stored ones, byte by byte, instead.
    fix
        Try the drivers that no driver file names, and register those that work, in your own folder.
    dry_run
        With --fix: say what would be written, only.
    device
        With --conformance: a number, a part of a name, gpu or host.
    mesh
        With --conformance: only this mesh; may be given several times.
    """
    from ..device.doctor import diagnose, register_drivers
    from ..errors import ConfigError, DeviceError

    if not timeout_s >= _LEAST_TIMEOUT_S:
        raise ConfigError(f"--timeout must be at least {_LEAST_TIMEOUT_S} second, not {timeout_s:g}")
    if dry_run and not fix:
        raise ConfigError("--dry-run needs --fix: without it `clbvh doctor` writes nothing")
    if conformance and fix:
        raise ConfigError("--conformance compares answers, and --fix registers drivers: give one of them")
    if conformance:
        _check_conformance(device, mesh or [], as_json)
        return
    if device is not None or mesh:
        raise ConfigError("--device and --mesh need --conformance: without it `clbvh doctor` checks all devices")
    steps = register_drivers(timeout_s, dry_run=dry_run) if fix else []
    findings, trials = diagnose(timeout_s)
    working_count = sum(not trial.error for trial in trials)
    if as_json:
        devices = [info.as_dict() | {"works": not error, "error": error} for info, error, _ in trials]
        report = {"works": working_count > 0, "findings": [vars(finding) for finding in findings], "devices": devices}
        print_json(report | ({"dry_run": dry_run, "steps": [vars(step) for step in steps]} if fix else {}))
    else:
        for step in steps:
            if step.action == "leave":
                print(f"left alone: {step.library} ({step.reason})")
            else:
                print(f"{'would write' if dry_run else 'wrote'} {step.path} ({step.library}: {step.reason})")
                print(f"{_INDENT}to undo it: rm {shlex.quote(str(step.path))}")
        if fix and not steps:
            print("nothing to fix: every driver that was found is registered")
        _print_findings(findings)
        print(f"\n{working_count} of {len(trials)} devices work")
    if not working_count:
        raise DeviceError("no device works: the findings of `clbvh doctor` say what to do")


def _print_findings(findings: list[Finding]) -> None:
    from rich.console import Console
    from rich.text import Text

    console = Console(soft_wrap=True, highlight=False)
    for finding in findings:
        console.print(Text.assemble((f"{finding.severity:7}", _COLOURS[finding.severity]), f" {finding.message}"))
        for line in finding.advice:
            console.print(Text(f"{_INDENT}{line}", style="bold" if line.startswith("$") else ""))


def _check_conformance(spec: str | None, meshes: list[str], as_json: bool) -> None:
    from ..conformance.check import check_device
    from ..device.select import choose_device
    from ..errors import ValidationError

    result = check_device(choose_device(spec), meshes=meshes)
    if as_json:
        print_json({"device": result.device.as_dict(), **result.as_dict()})
    else:
        total = sum(result.compared.values())
        print(f"{result.device}: {total - len(result.differences)} of {total} parts of the stored answers are equal")
    if not result.is_equal:
        unusable = "its rays or points have other bytes on this machine than the stored ones"
        found = [*map(str, result.differences), *(f"mesh '{name}': {unusable}" for name in result.unusable)]
        raise ValidationError(f"{result.device.name}: {len(found)} answers are not the stored ones; first {found[0]}")
