"""`clbvh doctor`: the causes of a missing or failing device, and remedies."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from .devices import describe_device

if TYPE_CHECKING:
    from ..device.doctor.diagnose import Diagnosis

_MARKS = {"ok": "[green]ok[/green]     ", "note": "[yellow]note[/yellow]   ", "problem": "[red]problem[/red]"}
_INDENT = " " * 8

# The default of `diagnose`, repeated because importing it would make `clbvh --help` slow.
_TIMEOUT_S = 60.0


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of the text.")] = False,
    timeout_s: Annotated[
        float,
        typer.Option("--timeout", min=1, metavar="SECONDS", help="Time limit for each answer of a driver."),
    ] = _TIMEOUT_S,
) -> None:
    """Check OpenCL from the loader to a kernel on each device; print faults and remedies."""
    from ..device.doctor.diagnose import diagnose
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
