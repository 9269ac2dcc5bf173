"""`clbvh warmup`: do each kind of work once, and a table of the time that each took."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import options

if TYPE_CHECKING:
    from ..device.info import DeviceInfo

_ALL = "all"


def warmup(
    device: Annotated[
        str | None,
        typer.Option(
            help="A number, a part of a name, gpu or cpu, see `clbvh devices`; or all.",
            show_default="a GPU, if there is one",
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Compile functions and kernels ahead, by doing each kind of work once; for container images, too."""
    from rich.console import Console

    from ..support.say_once import say_compiling
    from ..warmup import list_work

    devices = _choose_devices(device)
    say_compiling("compiling for this machine what is not compiled yet: minutes on a new one")
    steps: list[dict[str, Any]] = []
    with Console(stderr=True).status("") as status:
        for info in devices:
            for what, work in list_work(info):
                status.update(f"{what} ...")
                begin = time.perf_counter()
                work()
                steps.append({"device": info.name, "what": what, "ms": (time.perf_counter() - begin) * 1e3})
    report = {
        "devices": [info.name for info in devices],
        "steps": steps,
        "total_ms": sum(step["ms"] for step in steps),
    }
    if as_json:
        print(json.dumps(report, indent=2))
        return
    from .tables import add_time, make_times, print_tables

    times = make_times()
    for step in steps:
        add_time(times, step["what"], step["ms"], step["device"])
    add_time(times, "total", report["total_ms"], "", style="bold")
    print_tables(times)


def _choose_devices(device: str | None) -> list[DeviceInfo]:
    from ..device.select import choose_device, list_devices
    from ..errors import DeviceError

    if device is None or device.strip().lower() != _ALL:
        return [choose_device(device)]
    devices = [info for info in list_devices() if info.is_available]
    if not devices:
        raise DeviceError("no OpenCL device was found: run `clbvh doctor` to find the cause")
    return devices
