"""`clbvh study`: the report's experiments and the contest with other engines, as one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from . import options

# The remaining time is estimated from the pace of these seconds.
_PACE_S = 600.0


def study(
    *names: Annotated[str, Parameter(name="EXPERIMENT")],
    output: Annotated[Path, Parameter(name=("--output", "-o"), metavar="DIR", show_default=True)] = Path("out/study"),
    quick: bool = False,
    only_page: Annotated[bool, Parameter(name="--page")] = False,
    device: options.Device = None,
    show_list: Annotated[bool, Parameter(name="--list")] = False,
) -> None:
    """Repeat the report's experiments on this machine, and write one page with all figures.

    Every sample is kept at once: after Ctrl-C the same command goes on where it was.

    Parameters
    ----------
    names
        Only these experiments; see --list.
    output
        Folder of the page and the samples.
    quick
        Fewer and smaller cases: about four minutes on two cores.
    only_page
        Measure nothing: write the page again from the samples that are there.
    show_list
        List the experiments and end.
    """
    if show_list:
        from ..study.experiments import EXPERIMENTS

        longest = max(map(len, EXPERIMENTS))
        for experiment in EXPERIMENTS.values():
            print(f"{experiment.name:{longest}}  {experiment.texts[1]}")
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
            output, names, scale=QUICK if quick else FULL, device=device, only_page=only_page, on_progress=follow,
            on_note=note,
        )  # fmt: skip
    print(done.page, done.samples, done.table, sep="\n")
