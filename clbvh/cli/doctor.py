"""`clbvh doctor`: why a device is missing or does not work, and what to do about it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..device.diagnose import Diagnosis

_MARKS = {"ok": "[green]ok[/green]     ", "note": "[yellow]note[/yellow]   ", "problem": "[red]problem[/red]"}
_INDENT = " " * 8

# Also the default of `diagnose`, repeated here because importing it would make `clbvh --help` slow.
_TIMEOUT_S = 60.0


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of the text.")] = False,
    timeout_s: Annotated[
        float,
        typer.Option("--timeout", min=1, metavar="SECONDS", help="How long one driver may take to answer."),
    ] = _TIMEOUT_S,
) -> None:
    """Check OpenCL from the loader to a kernel on each device; say what is missing and what to do."""
    from ..device.diagnose import diagnose
    from ..errors import DeviceError

    diagnosis = diagnose(timeout_s)
    if as_json:
        print(json.dumps(_as_dict(diagnosis), indent=2))
    else:
        _print_findings(diagnosis)
    if not diagnosis.works:
        raise DeviceError("no OpenCL device works: the findings of `clbvh doctor` say what to do")


def _as_dict(diagnosis: Diagnosis) -> dict[str, object]:
    return {
        "works": diagnosis.works,
        "findings": [finding.as_dict() for finding in diagnosis.findings],
        "devices": [
            trial.device.as_dict() | {"works": trial.works, "error": trial.error, "wall_s": round(trial.wall_s, 3)}
            for trial in diagnosis.trials
        ],
    }


def _print_findings(diagnosis: Diagnosis) -> None:
    from rich.console import Console
    from rich.markup import escape

    # Commands must come out on one line each, so that they can be copied.
    console = Console(highlight=False, soft_wrap=True)
    for finding in diagnosis.findings:
        console.print(f"{_MARKS[finding.severity]} {escape(finding.message)}")
        for line in finding.advice:
            style = "bold" if line.startswith("$") else "dim"
            console.print(f"{_INDENT}{escape(line)}", style=style)
    working_count = sum(trial.works for trial in diagnosis.trials)
    console.print(f"\n{working_count} of {len(diagnosis.trials)} devices work")
