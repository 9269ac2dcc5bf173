"""`clbvh tune`: measure the fastest layout, work-group size and tile of a device, and keep them."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from . import options
from .tables import make_facts, make_table, print_report, print_tables

if TYPE_CHECKING:
    from pathlib import Path

    from ..device.info import DeviceInfo
    from ..device.settings import Settings
    from ..rendering.tune import Trial


def tune(
    *,
    device: options.Device = None,
    every: Annotated[bool, Parameter(name="--all")] = False,
    as_json: options.AsJson = False,
) -> None:
    """Measure layouts, work-group sizes and tiles on a device, and keep the fastest for later runs.

    Parameters
    ----------
    every
        All devices, so that the fastest of several drivers is taken from then on.
    """
    from ..device.select import choose_device, list_devices
    from ..device.settings import keep_settings
    from ..errors import ConfigError
    from ..rendering.tune import tune as measure

    if every and device is not None:
        raise ConfigError("--all measures all devices, and --device one: give one of them")
    usable: list[DeviceInfo | str | None] = [device]
    if every:
        # Without any device, the choice of one says so.
        found = [other for other in list_devices() if other.is_available and not other.is_emulated]
        usable = [*found] or [choose_device()]
    reports = []
    for each in usable:
        info, settings, trials = measure(each)
        path = keep_settings(info, settings)
        if not as_json:
            _print_trials(info, settings, trials, path)
        facts = {"device": info.name, "driver": info.driver_version, "kept_in": str(path)}
        measured = [asdict(trial) for trial in trials]
        reports.append(facts | {"settings": asdict(settings), "trials": measured})
    if as_json or every:
        line = "the devices from now on: " + "; ".join(map(str, list_devices()))
        print_report({"devices": reports} if every else reports[0], line, as_json=as_json)


def _print_trials(info: DeviceInfo, settings: Settings, trials: list[Trial], path: Path) -> None:
    listed = ((trial.what, trial.choice, f"{trial.ms:,.1f}", "taken" if trial.is_best else "") for trial in trials)
    table = make_table(("", "", "ms", ""), listed, numbers=["ms"])
    columns, rows = settings.tile
    taken = f"{settings.layout}, work-groups of {settings.work_group_size} rays, tiles of {columns} x {rows} pixels"
    facts = {"device": str(info), "driver": info.driver_version, "kept": str(path), "taken": taken}
    print_tables(table, make_facts(facts))
