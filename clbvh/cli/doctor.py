"""`clbvh doctor`: the causes of a missing or failing device, and remedies."""

from __future__ import annotations

import json
import shlex
from typing import TYPE_CHECKING, Annotated

import typer

from .devices import describe_device
from .tables import print_tables

if TYPE_CHECKING:
    from ..conformance.check import Conformance
    from ..device.doctor import Finding, Step

_MARKS = {"ok": "[green]ok[/green]     ", "note": "[yellow]note[/yellow]   ", "problem": "[red]problem[/red]"}
_INDENT = " " * 8

# A first compilation takes about a second with PoCL; the first use of a GPU after boot can take ten.
_TIMEOUT_S = 60.0

# Differences that are printed; `--json` has all.
_SHOWN_DIFFERENCES = 10


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of the text.")] = False,
    timeout_s: Annotated[
        float,
        typer.Option("--timeout", min=1, metavar="SECONDS", help="Time limit for each answer of a driver."),
    ] = _TIMEOUT_S,
    conformance: Annotated[
        bool,
        typer.Option("--conformance", help="Compare one device's answers with the stored ones, byte by byte, instead."),
    ] = False,
    fix: Annotated[
        bool,
        typer.Option(
            "--fix", help="Try the drivers that no driver file names, and register those that work, in your own folder."
        ),
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="With --fix: say what would be written, only.")] = False,
    device: Annotated[
        str | None, typer.Option(help="With --conformance: a number, a part of a name, gpu or cpu.")
    ] = None,
    mesh: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="With --conformance: only this mesh; may be given several times."),
    ] = None,
) -> None:
    """Check OpenCL from the loader to a kernel on each device; print faults and remedies."""
    from ..device.doctor import diagnose, register_drivers
    from ..errors import ConfigError, DeviceError

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
    if fix and not as_json:
        _print_steps(steps, dry_run)
    findings, trials = diagnose(timeout_s)
    works = not all(trial.error for trial in trials)
    if as_json:
        devices = [
            describe_device(info) | {"works": not error, "error": error, "wall_s": round(wall_s, 3)}
            for info, error, wall_s in trials
        ]
        report = {"works": works, "findings": [vars(finding) for finding in findings], "devices": devices}
        if fix:
            report |= {"dry_run": dry_run, "steps": [vars(step) for step in steps]}
        print(json.dumps(report, indent=2, default=str))
    else:
        _print_findings(findings)
        print(f"\n{sum(not trial.error for trial in trials)} of {len(trials)} devices work")
    if not works:
        raise DeviceError("no OpenCL device works: the findings of `clbvh doctor` say what to do")


def _print_steps(steps: list[Step], dry_run: bool) -> None:
    done = {"write": "would write", "remove": "would remove"} if dry_run else {"write": "wrote", "remove": "removed"}
    for step in steps:
        if step.action == "leave":
            print(f"left alone: {step.library} ({step.reason})")
        else:
            print(f"{done[step.action]} {step.path} ({step.library}: {step.reason})")
        if step.action == "write":
            print(f"{_INDENT}to undo it: rm {shlex.quote(str(step.path))}")
    print("" if steps else "nothing to fix: every driver that was found is registered\n")


def _print_findings(findings: list[Finding]) -> None:
    from rich.console import Console
    from rich.markup import escape

    # Each command stays on one line, so that it can be copied.
    console = Console(highlight=False, soft_wrap=True)
    for finding in findings:
        console.print(f"{_MARKS[finding.severity]} {escape(finding.message)}")
        for line in finding.advice:
            console.print(f"{_INDENT}{escape(line)}", style="bold" if line.startswith("$") else "dim")


def _check_conformance(spec: str | None, meshes: list[str], as_json: bool) -> None:
    from ..conformance.check import check_device
    from ..device.select import choose_device
    from ..errors import ValidationError

    result = check_device(choose_device(spec), meshes=meshes)
    if as_json:
        print(json.dumps({"device": describe_device(result.device), **result.as_dict()}, indent=2))
    else:
        _print_conformance(result)
    if not result.is_equal:
        unusable = "its rays or points have other bytes on this machine than the stored ones"
        found = [*map(str, result.differences), *(f"mesh '{name}': {unusable}" for name in result.unusable)]
        raise ValidationError(f"{result.device.name}: {len(found)} answers are not the stored ones; first {found[0]}")


def _print_conformance(result: Conformance) -> None:
    """Print how many meshes' answers were compared, or differ, for each query and layout."""
    from rich.table import Table

    layouts, queries = (list(dict.fromkeys(key[axis] for key in result.compared)) for axis in (0, 1))
    differing = [(difference.layout, difference.query) for difference in result.differences]
    table = Table("query", *layouts, box=None, pad_edge=False, header_style="bold")
    for query in queries:
        cells = []
        for key in ((layout, query) for layout in layouts):
            count, wrong = result.compared.get(key, 0), differing.count(key)
            equal = f"{count} equal" if count else "-"
            cells.append(f"[red]{wrong} of {count} differ[/red]" if wrong else equal)
        table.add_row(query, *cells)
    print(f"{result.device.name} ({result.device.platform}, {result.device.driver_version})")
    print_tables(table)
    for difference in result.differences[:_SHOWN_DIFFERENCES]:
        print(difference)
