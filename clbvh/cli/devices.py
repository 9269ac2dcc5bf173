"""`clbvh devices`: what can be chosen with `--device`."""

from __future__ import annotations

import json
import re
import sys
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..device.select import DeviceInfo, DeviceSurvey

_MIB = 1 << 20
_GIB = 1 << 30

# Of a table that goes into a file or a pipe: nothing is cut off there, and nobody's window is too narrow.
_PIPE_WIDTH = 250


def devices(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of the table.")] = False,
) -> None:
    """List the OpenCL devices, the one that is used by default marked."""
    from ..device.select import choose_device, survey_devices
    from ..errors import DeviceError

    survey = survey_devices()
    default: DeviceInfo | None = None
    reason = ""
    try:
        default = choose_device()
    except DeviceError as error:
        reason = str(error)

    if as_json:
        listed = [device.as_dict() | {"is_default": device == default} for device in survey.devices]
        print(json.dumps({"devices": listed, "problems": list(survey.problems)}, indent=2))
    elif survey.devices:
        _print_table(survey, default)
    if not survey.devices:
        raise DeviceError(reason)

    # What is below the table is for a reader; with --json it must not mix with the object.
    for sentence in [*survey.problems, reason]:
        if sentence:
            print(f"clbvh: {sentence}", file=sys.stderr)


def _print_table(survey: DeviceSurvey, default: DeviceInfo | None) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("", "device", "platform", "version", "driver", "memory", "units", "fp64", "layout"):
        table.add_column(heading, justify="right" if heading in ("", "memory", "units") else "left", overflow="fold")
    for device in survey.devices:
        is_default = device == default
        name = device.name if device.is_available else f"{device.name} (not available)"
        table.add_row(
            f"{'*' if is_default else ' '} {device.number}",
            f"{escape(name)} [dim]{device.kind}[/dim]",
            escape(device.platform),
            escape(_shorten_version(device.version)),
            escape(device.driver_version),
            _format_memory(device.memory_bytes),
            str(device.compute_units),
            "yes" if device.has_fp64 else "no",
            device.layout,
            style="bold" if is_default else "",
        )
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_PIPE_WIDTH)
    console.print(table)
    if default is not None:
        console.print("* used by default; choose with --device NUMBER, a part of a name, gpu or cpu", style="dim")


def _shorten_version(version: str) -> str:
    """Return the number that follows "OpenCL"; what drivers append to it fills a line."""
    match = re.match(r"OpenCL \d+\.\d+", version)
    return match[0] if match else version


def _format_memory(size_bytes: int) -> str:
    return f"{size_bytes / _GIB:.1f} GiB" if size_bytes >= _GIB else f"{size_bytes / _MIB:.0f} MiB"
