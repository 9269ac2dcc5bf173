"""`clbvh tune`: measure the fastest layout, work-group size and tile of a device, and keep them."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from . import options

if TYPE_CHECKING:
    from pathlib import Path

    from ..device.info import DeviceInfo
    from ..device.settings import Settings
    from ..rendering.tune import Trial


def tune(
    device: Annotated[
        str | None,
        typer.Option(
            help="A number, a part of a name, gpu or cpu; see `clbvh devices`.", show_default="a GPU, if there is one"
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Measure layouts, work-group sizes and tiles on a device, and keep the fastest for later runs."""
    from ..device.settings import keep_settings
    from ..rendering.tune import tune as measure

    info, settings, trials = measure(device)
    path = keep_settings(info, settings)
    if as_json:
        facts = {"device": info.name, "driver": info.driver_version, "kept_in": str(path)}
        measured = [asdict(trial) for trial in trials]
        print(json.dumps(facts | {"settings": asdict(settings), "trials": measured}, indent=2))
    else:
        _print_trials(info, settings, trials, path)


def _print_trials(info: DeviceInfo, settings: Settings, trials: list[Trial], path: Path) -> None:
    from rich.markup import escape
    from rich.table import Table

    from .tables import make_facts, print_tables

    facts = make_facts()
    facts.add_row("device", escape(str(info)))
    facts.add_row("driver", escape(info.driver_version))
    facts.add_row("kept", escape(str(path)))
    table = Table(box=None, pad_edge=False, header_style="dim")
    for heading in ("", "", "ms", ""):
        table.add_column(heading, justify="right" if heading == "ms" else "left")
    for trial in trials:
        mark = "taken" if trial.is_best else ""
        table.add_row(trial.what, trial.choice, f"{trial.ms:,.1f}", mark, style="bold" if trial.is_best else "")
    columns, rows = settings.tile
    facts.add_row(
        "taken",
        f"{settings.layout}, work-groups of {settings.work_group_size} rays, tiles of {columns} x {rows} pixels",
    )
    print_tables(table, facts)
