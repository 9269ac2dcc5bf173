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
    from ..device.doctor.diagnose import Diagnosis
    from ..device.doctor.register import Step

_MARKS = {"ok": "[green]ok[/green]     ", "note": "[yellow]note[/yellow]   ", "problem": "[red]problem[/red]"}
_INDENT = " " * 8

# The default of `diagnose`, repeated because importing it would make `clbvh --help` slow.
_TIMEOUT_S = 60.0

# Differences that are printed; `--json` has all.
_SHOWN_DIFFERENCES = 10

_UNUSABLE = "its rays or points have other bytes on this machine than the stored ones"


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
    from ..device.doctor.diagnose import diagnose
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
    steps = _register(timeout_s, dry_run, as_json) if fix else []
    diagnosis = diagnose(timeout_s)
    if as_json:
        report = _as_dict(diagnosis)
        if fix:
            report |= {"dry_run": dry_run, "steps": [step.as_dict() for step in steps]}
        print(json.dumps(report, indent=2))
    else:
        _print_findings(diagnosis)
    if not diagnosis.works:
        raise DeviceError("no OpenCL device works: the findings of `clbvh doctor` say what to do")


def _register(timeout_s: float, dry_run: bool, quiet: bool) -> list[Step]:
    """Register the drivers that work, and say what is written."""
    from ..device.doctor.register import carry_out, plan_registrations

    steps = plan_registrations(timeout_s)
    words = {"write": "would write" if dry_run else "writing", "remove": "would remove" if dry_run else "removing"}
    if not quiet and not steps:
        print("nothing to fix: every driver that was found is registered\n")
    if not quiet and steps:
        for step in steps:
            what = f"{words.get(step.action, 'left alone:')} {step.path if step.action != 'leave' else step.library}"
            print(f"{what} ({step.library}: {step.reason})" if step.action != "leave" else f"{what} ({step.reason})")
            if step.action == "write":
                print(f"{_INDENT}to undo it: rm {shlex.quote(str(step.path))}")
        print()
    if not dry_run:
        carry_out(steps)
    return steps


def _as_dict(diagnosis: Diagnosis) -> dict[str, object]:
    return {
        "works": diagnosis.works,
        "findings": [finding.as_dict() for finding in diagnosis.findings],
        "devices": [
            {
                **describe_device(trial.device),
                "works": trial.works,
                "error": trial.error,
                "wall_s": round(trial.wall_s, 3),
            }
            for trial in diagnosis.trials
        ],
    }


def _print_findings(diagnosis: Diagnosis) -> None:
    from rich.console import Console
    from rich.markup import escape

    # Each command stays on one line, so that it can be copied.
    console = Console(highlight=False, soft_wrap=True)
    for finding in diagnosis.findings:
        console.print(f"{_MARKS[finding.severity]} {escape(finding.message)}")
        for line in finding.advice:
            style = "bold" if line.startswith("$") else "dim"
            console.print(f"{_INDENT}{escape(line)}", style=style)
    working_count = sum(trial.works for trial in diagnosis.trials)
    console.print(f"\n{working_count} of {len(diagnosis.trials)} devices work")


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
        found = [*map(str, result.differences), *(f"mesh '{name}': {_UNUSABLE}" for name in result.unusable)]
        raise ValidationError(f"{result.device.name}: {len(found)} answers are not the stored ones; first {found[0]}")


def _print_conformance(result: Conformance) -> None:
    from rich.table import Table

    layouts = list(dict.fromkeys(layout for layout, _ in result.compared))
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("query", *layouts):
        table.add_column(heading)
    for query in dict.fromkeys(query for _, query in result.compared):
        table.add_row(query, *(_describe_cell(result, layout, query) for layout in layouts))
    print(f"{result.device.name} ({result.device.platform}, {result.device.driver_version})")
    print_tables(table)
    for difference in result.differences[:_SHOWN_DIFFERENCES]:
        print(difference)


def _describe_cell(result: Conformance, layout: str, query: str) -> str:
    """Return one cell: the number of meshes' answers that were compared, or that differ."""
    count = result.compared.get((layout, query), 0)
    differing = sum((other.layout, other.query) == (layout, query) for other in result.differences)
    return "-" if count == 0 else f"[red]{differing} of {count} differ[/red]" if differing else f"{count} equal"
