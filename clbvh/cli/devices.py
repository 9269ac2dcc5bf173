"""`clbvh devices`: the devices that `--device` can choose."""

from __future__ import annotations

import json
import re
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ..device.info import DeviceInfo
    from ..device.select import DeviceSurvey

_MIB = 1 << 20
_GIB = 1 << 30

# Width of a table that goes into a file or a pipe, where lines may be long.
_PIPE_WIDTH = 250


def devices(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of the table.")] = False,
) -> None:
    """List the OpenCL devices, with a mark on the default one."""
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
        listed = [describe_device(device) | {"is_default": device == default} for device in survey.devices]
        print(json.dumps({"devices": listed, "problems": list(survey.problems)}, indent=2))
    elif survey.devices:
        _print_table(survey, default)
    if not survey.devices:
        raise DeviceError(reason)

    # Sentences for a reader go to stderr; on stdout they would mix with the JSON object.
    for sentence in [*survey.problems, reason]:
        if sentence:
            print(f"clbvh: {sentence}", file=sys.stderr)
    if not any(device.is_available for device in survey.devices):
        raise DeviceError("no OpenCL device can be used: run `clbvh doctor` to find the cause")


def describe_device(device: DeviceInfo) -> dict[str, Any]:
    """Return the facts about a device for JSON, with the layout that it would use."""
    from ..device.settings import find_settings

    return device.as_dict() | {"layout": find_settings(device).layout}


def _print_table(survey: DeviceSurvey, default: DeviceInfo | None) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from ..device.settings import find_settings

    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("", "device", "platform", "version", "driver", "memory", "units", "fp64", "layout"):
        table.add_column(heading, justify="right" if heading in ("", "memory", "units") else "left", overflow="fold")
    rows = []
    for device in survey.devices:
        is_default = device == default
        name = device.name if device.is_available else f"{device.name} (not available)"
        row = (
            f"{'*' if is_default else ' '} {device.number}",
            f"{escape(name)} [dim]{device.kind}[/dim]",
            escape(device.platform),
            escape(_shorten_version(device.version)),
            escape(device.driver_version),
            _format_memory(device.memory_bytes),
            str(device.compute_units),
            "yes" if device.has_fp64 else "no",
            find_settings(device).layout,
        )
        table.add_row(*row, style="bold" if is_default else "")
        rows.append(row)
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_PIPE_WIDTH)
    unlimited = console.options.update(max_width=_PIPE_WIDTH)
    if console.measure(table, options=unlimited).maximum <= console.width:
        console.print(table)
    else:  # columns of a few letters would be unreadable
        for row in rows:
            console.print(_make_list(row))
    if default is not None:
        console.print("* used by default; choose with --device NUMBER, a part of a name, gpu or cpu", style="dim")


def _make_list(row: tuple[str, ...]) -> Any:
    """Return the row of a device as a short list, for a narrow terminal."""
    from rich.table import Table

    mark, name, platform, version, driver, memory, units, fp64, layout = row
    facts = Table(box=None, show_header=False, pad_edge=False)
    facts.add_row(mark, name)
    facts.add_row("", f"{platform}, {version}, driver {driver}")
    facts.add_row("", f"{memory}, {units} units, fp64 {fp64}, layout {layout}")
    return facts


def _shorten_version(version: str) -> str:
    """Return "OpenCL" and its number, without the text that drivers append."""
    match = re.match(r"OpenCL \d+\.\d+", version)
    return match[0] if match else version


def _format_memory(size_bytes: int) -> str:
    return f"{size_bytes / _GIB:.1f} GiB" if size_bytes >= _GIB else f"{size_bytes / _MIB:.0f} MiB"
