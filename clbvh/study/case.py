"""The parts that an experiment is made of."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .bench import Bench
    from .page.parts import Part
    from .results import Results
    from .scale import Scale

# The values that tell one row of an experiment's table from the others, such as {"mesh": "dragon", "workers": 2}.
Case = Mapping[str, str | int | float]


@dataclass(frozen=True)
class Sample:
    """One measurement of a case.

    Attributes
    ----------
    values : dict of str to float
        Quantities by name; the name ends in the unit: ``build_ms``. Wall time and the device's event time have
        different names.
    facts : dict of str to str
        What is no number, such as the digest of a picture.
    """

    values: dict[str, float]
    facts: dict[str, str] = field(default_factory=dict)


class NotMeasuredError(Exception):
    """A case cannot be measured on this machine; the message says why, and stands on the page."""


@dataclass(frozen=True)
class Experiment:
    """One experiment of the report, or a contest.

    Attributes
    ----------
    name, title : str
    question : str
        What it finds out, in one sentence.
    method : str
        How it is measured, where that is not the same for all experiments.
    cases : function
        From the scale of a study to the table of cases.
    measure : function
        Takes one sample of a case, with the means of a `Bench`.
    present : function
        From the results to the parts of the page.
    group : tuple of str
        Keys of the cases that are measured in turn, because their figures are compared: those that agree in these.
    weight : float
        Rough share of a study's time; only the estimate of the remaining time uses it.
    counts : bool
        The samples are counts that are the same each time: one of each is enough, and no warm-up is needed.
    """

    name: str
    title: str
    question: str
    method: str
    cases: Callable[[Scale], list[Case]]
    measure: Callable[[Bench, Case], Sample]
    present: Callable[[Results], list[Part]]
    group: tuple[str, ...] = ("mesh",)
    weight: float = 1.0
    counts: bool = False


def key_of(case: Case) -> str:
    """Return one text for equal cases."""
    return json.dumps(case, sort_keys=True)
