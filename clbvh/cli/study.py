"""`clbvh study`: the report's experiments and the contest with other engines, as one page."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from . import options

# The remaining time is estimated from the pace of these seconds.
_PACE_S = 600.0


def study(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[EXPERIMENT]...", help="Only these experiments; see --list.", show_default=False),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of the page and the samples.")
    ] = Path("out/study"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer and smaller cases: about four minutes on two cores.")
    ] = False,
    only_page: Annotated[
        bool, typer.Option("--page", help="Measure nothing: write the page again from the samples that are there.")
    ] = False,
    device: options.OnlyDevice = None,
    show_list: Annotated[bool, typer.Option("--list", help="List the experiments and end.")] = False,
) -> None:
    """Repeat the report's experiments on this machine, and write one page with all figures.

    Every sample is kept at once: after Ctrl-C the same command goes on where it was.
    """
    if show_list:
        _print_list()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from ..study.run import run_study
    from ..study.scale import FULL, QUICK

    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal, speed_estimate_period=_PACE_S
    ) as shown:
        bar = shown.add_task("", total=1.0)
        begun: set[str] = set()

        def follow(experiment: str, share: float) -> None:
            shown.update(bar, description=experiment, completed=share)
            if not console.is_terminal and experiment not in begun:
                # A line for each experiment is enough for a log.
                begun.add(experiment)
                note(f"{experiment} begins at {100 * share:.0f} %")

        def note(text: str) -> None:
            shown.console.print(f"clbvh: {text}", markup=False, highlight=False, soft_wrap=True)

        done = run_study(
            output, names or (), scale=QUICK if quick else FULL, device=device, only_page=only_page,
            on_progress=follow, on_note=note,
        )  # fmt: skip
    print(done.page)
    print(done.samples)
    print(done.table)
    sys.stdout.flush()


def _print_list() -> None:
    from ..study.registry import EXPERIMENTS

    longest = max(map(len, EXPERIMENTS))
    for experiment in EXPERIMENTS.values():
        print(f"{experiment.name:{longest}}  {experiment.texts[1]}")
