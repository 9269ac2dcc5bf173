"""`clbvh warmup`: compile ahead, and a table of what was compiled."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options

if TYPE_CHECKING:
    from ..device.info import DeviceInfo
    from ..warmup.warm_up import WarmStep

_ALL = "all"


def warmup(
    device: Annotated[
        str | None,
        typer.Option(
            help="A number, a part of a name, gpu or cpu, see `clbvh devices`; or all.",
            show_default="a GPU, if there is one",
        ),
    ] = None,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="Leave out the ladder's builders, --validate, and all layouts but the device's own: few programs need "
            "them.",
        ),
    ] = False,
    as_json: options.AsJson = False,
) -> None:
    """Compile all functions and kernels ahead, so that no later run has to; for container images, too."""
    from rich.console import Console

    from ..support.code_times import on_first_compilation
    from ..support.stopwatch import Stopwatch
    from ..warmup.warm_up import warm_up

    on_first_compilation(None)  # the table says it
    devices = _choose_devices(device)
    watch = Stopwatch()
    steps = []
    with Console(stderr=True).status("compiling ...") as status:
        for step in warm_up(devices, quick=quick):
            steps.append(step)
            status.update(f"compiling ... {step.what}: {step.compiled} new")
    report = {
        "devices": [info.name for info in devices],
        "compiled": sum(step.compiled for step in steps),
        "loaded": sum(step.loaded for step in steps),
        "compile_ms": sum(step.compile_ms for step in steps),
        "total_ms": watch.total_ms,
        "steps": [asdict(step) for step in steps],
    }
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        _print_report(report, steps)


def _choose_devices(device: str | None) -> list[DeviceInfo]:
    from ..device.select import choose_device, list_devices
    from ..errors import DeviceError

    if device is None or device.strip().lower() != _ALL:
        return [choose_device(device)]
    devices = [info for info in list_devices() if info.is_available]
    if not devices:
        raise DeviceError("no OpenCL device was found: run `clbvh doctor` to find the cause")
    return devices


def _print_report(report: dict[str, Any], steps: list[WarmStep]) -> None:
    from rich.markup import escape
    from rich.table import Table

    from .tables import make_facts, print_tables

    table = Table(box=None, pad_edge=False, header_style="dim")
    for heading in ("on", "for", "compiled", "s", "there"):
        table.add_column(heading, justify="left" if heading in ("on", "for") else "right")
    for step in steps:
        table.add_row(
            escape(step.where), step.what, str(step.compiled), f"{step.compile_ms / 1e3:.1f}", str(step.loaded)
        )
    facts = make_facts()
    if report["compiled"]:
        count = report["compiled"]
        many = "functions and kernels" if count > 1 else "function or kernel"
        done = f"{count:,} {many} in {report['compile_ms'] / 1e3:.1f} s"
    else:
        done = "nothing: all is there"
    facts.add_row("compiled", done)
    facts.add_row("total", f"{report['total_ms'] / 1e3:.1f} s")
    print_tables(table, facts)
