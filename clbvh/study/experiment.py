"""What an experiment is: its cases, measurement and section of the page; and the report's figures beside ours."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Iterable, Sequence
from functools import cache, reduce
from operator import getitem
from pathlib import Path
from typing import Any

from .bench import Bench
from .page import Part, Section, write_caption
from .samples import Case, Results, Sample
from .scale import Scale
from .statistics import NOISY_SPREAD

# Load averages above the number of cores and this share of them: something else was running.
_BUSY_SHARE = 1.5


class Experiment:
    """One experiment of the report, or a contest.

    A subclass's docstring is its text on the page: a title, the question in one sentence, and how it is measured where
    that is not the same for all experiments; one paragraph each.

    Attributes
    ----------
    group : tuple of str
        Keys of the cases that are measured in turn, because their figures are compared: those that agree in these.
    weight : float
        Rough share of a study's time; only the estimate of the remaining time uses it.
    counts : bool
        The samples are counts that are the same each time: one of each is enough, and no warm-up is needed.
    """

    group: tuple[str, ...] = ("mesh",)
    weight = 1.0
    counts = False

    @property
    def name(self) -> str:
        """The class's name in small letters, by which the command line and the samples call it."""
        return type(self).__name__.lower()

    def cases(self, scale: Scale) -> list[Case]:
        """Return the table of cases."""
        raise NotImplementedError

    def measure(self, bench: Bench, case: Case) -> Sample:
        """Take one sample of a case."""
        raise NotImplementedError

    def present(self, results: Results) -> Iterable[Part]:
        """Yield the parts of the page for at least one measured case."""
        raise NotImplementedError

    @property
    def texts(self) -> tuple[str, str, str]:
        """The title, the question and the method."""
        paragraphs = inspect.cleandoc(type(self).__doc__ or self.name).split("\n\n")
        title, question, method, *_ = [" ".join(paragraph.split()) for paragraph in paragraphs] + ["", ""]
        return title.removesuffix("."), question, method

    def say(self, results: Results, part: str, *values: Any) -> str:
        """Return a longer caption or a paragraph of this experiment; see `captions.md.jinja`."""
        context = {"report": _read().get(self.name, {}), "size": results.scale.size_of}
        return write_caption(f"{self.name}_{part}", *values, results=results, **context)

    def make_section(self, results: Results) -> Section:
        """Return the section of the page: what the experiment presents, noise, and what was not measured."""
        parts = [*self.present(results)] if results.cases else []
        notes = [*([] if self.counts else _note_noise(results)), *_note_failures(results.failures)]
        return Section(self.name, *self.texts, parts, notes)


def count_noisy(results: Results) -> tuple[int, int]:
    """Return the number of noisy times, and of all."""
    summaries = [
        results.summary(case, quantity)
        for case in results.cases
        for quantity in results.quantities(case, "")
        if quantity.endswith("_ms")
    ]
    return sum(summary.is_noisy for summary in summaries), len(summaries)


def _note_noise(results: Results) -> list[str]:
    """Say how many figures are noisy, and whether the machine was busy with something else."""
    noisy, count = count_noisy(results)
    apart = f"{100 * NOISY_SPREAD:.0f} %"
    load, cores = results.highest_load, results.cores
    notes = [f"Noise: {noisy} of {count} measured times have samples more than {apart} apart."] * bool(noisy)
    if load > _BUSY_SHARE * cores + 1:
        notes.append(f"The machine was busy: the load average reached {load:g} on {cores} cores.")
    return notes


def _note_failures(failures: Sequence[tuple[Case, str]]) -> list[str]:
    """Say what was not measured, cases of one reason together."""
    by_reason: dict[str, list[Case]] = {}
    for case, reason in failures:
        by_reason.setdefault(reason, []).append(case)
    notes = []
    for reason, cases in by_reason.items():
        # The values that all these cases share name them best.
        shared = set.intersection(*(set(case.items()) for case in cases))
        named = ", ".join(f"{name} {value}" for name, value in cases[0].items() if (name, value) in shared)
        notes.append(f"Not measured, {len(cases)} case{'s' if len(cases) > 1 else ''} ({named}): {reason}.")
    return notes


@cache
def _read() -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_name("report.toml").read_text("utf-8"))


def published(path: str) -> Any:
    """Return a figure or a table of the report by its path, such as ``"scaling.build_ms"``."""
    return reduce(getitem, path.split("."), _read())


def curve(path: str) -> dict[int, float]:
    """Return a table of the report whose keys are numbers."""
    return {int(key): float(value) for key, value in published(path).items()}
