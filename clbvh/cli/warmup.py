"""`clbvh warmup`: do each kind of work once, and a table of the time that each took."""

from __future__ import annotations

import time
from typing import Annotated, Any

from cyclopts import Parameter

from . import options
from .tables import make_table, print_report


def warmup(
    *,
    device: Annotated[options.Device, Parameter(help=f"{options.DEVICE_HELP} Or all.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Compile the kernels of OpenCL devices ahead, by doing each kind of work once; for images, too."""
    from rich.console import Console

    from ..device.select import choose_device, list_devices
    from ..warmup import list_work

    if (device or "").strip().lower() == "all":
        # Without any device, the choice of one says so.
        devices = [info for info in list_devices() if info.is_available] or [choose_device()]
    else:
        devices = [choose_device(device)]
    steps: list[dict[str, Any]] = []
    with Console(stderr=True).status("") as status:
        for info in devices:
            for what, work in list_work(info):
                status.update(f"{what} ...")
                begin = time.perf_counter()
                work()
                steps.append({"device": info.name, "what": what, "ms": (time.perf_counter() - begin) * 1e3})
    total_ms = sum(step["ms"] for step in steps)
    report = {"devices": [info.name for info in devices], "steps": steps, "total_ms": total_ms}
    rows = [(step["what"], f"{step['ms']:,.1f}", step["device"]) for step in steps]
    table = make_table(("work", "ms", "device"), [*rows, ("total", f"{total_ms:,.1f}", "")], numbers=["ms"])
    print_report(report, table, as_json=as_json)
