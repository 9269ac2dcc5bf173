"""`clbvh devices`: the devices that `--device` can choose."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from . import options
from .tables import make_table, print_json, print_notes

if TYPE_CHECKING:
    from ..device.info import DeviceInfo

_MIB = 1 << 20
_GIB = 1 << 30

# Width of a table that goes into a file or a pipe, where lines may be long.
_PIPE_WIDTH = 250


def devices(*, as_json: options.AsJson = False) -> None:
    """List the devices, the host first, with a mark on the default one."""
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
        print_json({"devices": listed, "problems": list(survey.problems)})
    elif survey.devices:
        _print_table(survey.devices, default)
    if not survey.devices:
        raise DeviceError(reason)

    # Sentences for a reader go to stderr; on stdout they would mix with the JSON object.
    print_notes(filter(None, [*survey.problems, reason]))
    if not any(device.is_available for device in survey.devices):
        raise DeviceError("no device can be used: run `clbvh doctor` to find the cause")


def _print_table(devices: tuple[DeviceInfo, ...], default: DeviceInfo | None) -> None:
    from rich.console import Console
    from rich.table import Table

    rows = [_describe_row(device, device == default) for device in devices]
    headings = "", "device", "platform", "version", "driver", "memory", "units", "fp64", "layout"
    table = make_table(headings, rows, numbers=("", "memory", "units"))
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = _PIPE_WIDTH
    unlimited = console.options.update(max_width=_PIPE_WIDTH)
    if console.measure(table, options=unlimited).maximum <= console.width:
        console.print(table)
    else:  # columns of a few letters would be unreadable
        for mark, name, platform, version, driver, memory, units, fp64, layout in rows:
            facts = Table(box=None, show_header=False, pad_edge=False)
            facts.add_row(mark, name)
            facts.add_row("", f"{platform}, {version}, driver {driver}")
            facts.add_row("", f"{memory}, {units} units, fp64 {fp64}, layout {layout}")
            console.print(facts)
    if default is not None:
        console.print("* used by default; choose with --device NUMBER, a part of a name, gpu or host", style="dim")


def _describe_row(device: DeviceInfo, is_default: bool) -> tuple[str, ...]:
    from rich.markup import escape

    name = device.name if device.is_available else f"{device.name} (not available)"
    # Drivers append a text to "OpenCL" and its number.
    version = re.match(r"OpenCL \d+\.\d+", device.version)
    size = device.memory_bytes
    return (
        f"{'*' if is_default else ' '} {device.number}",
        f"{escape(name)} [dim]{device.kind}[/dim]",
        escape(device.platform),
        escape(version[0] if version else device.version),
        escape(device.driver_version),
        f"{size / _GIB:.1f} GiB" if size >= _GIB else f"{size / _MIB:.0f} MiB",
        str(device.compute_units),
        "yes" if device.has_fp64 else "no",
        device.layout,
    )
