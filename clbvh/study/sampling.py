"""How samples are taken: warm-up, rounds in which the cases take turns, and each sample kept at once."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from ..errors import ClbvhError
from .bench import Bench
from .case import Case, Experiment, NotMeasuredError, Sample, key_of
from .machine import Machine, load_average
from .sample_file import SampleFile
from .scale import Scale

# Called after each measurement, counted or not.
Tick = Callable[[], None]


def group_cases(experiment: Experiment, cases: list[Case]) -> dict[str, list[Case]]:
    """Return the cases by groups that are measured together."""
    groups: dict[str, list[Case]] = {}
    for case in cases:
        groups.setdefault(key_of({name: case[name] for name in experiment.group}), []).append(case)
    return groups


def sample_group(
    experiment: Experiment, group: str, cases: list[Case], scale: Scale, machine: Machine, samples: SampleFile,
    pictures: Path, tick: Tick,
) -> None:  # fmt: skip
    """Take the samples that a group of cases lacks.

    Parameters
    ----------
    experiment : Experiment
    group : str
        The name of the group, from `group_cases`.
    cases : list of Case
    scale : Scale
    machine : Machine
    samples : SampleFile
        The samples so far; new ones are added one by one.
    pictures : Path
        See `Bench`.
    tick : function
        Called after each measurement.

    Notes
    -----
    Every case is measured once without counting it: compiled code, caches and worker pools are warm then. In each
    round all cases take their turn, forwards and backwards by turns, so that a drift of the machine's speed meets all
    of them. A case that cannot be measured does not stop the others.
    """
    rounds, least_rounds = (1, 1) if experiment.counts else (scale.rounds, scale.least_rounds)
    with Bench(scale, machine, pictures) as bench:
        failed: set[str] = set()

        def measure(case: Case) -> Sample | None:
            if key_of(case) in failed:
                return None
            try:
                return experiment.measure(bench, case)
            except (NotMeasuredError, ClbvhError, MemoryError) as error:
                failed.add(key_of(case))
                samples.add_failure(experiment.name, case, str(error) or type(error).__name__)
                return None
            finally:
                tick()

        if not experiment.counts:
            for case in cases:
                measure(case)
        taken = {key_of(case): samples.count(experiment.name, case) for case in cases}
        begin = time.monotonic()
        for turn in range(rounds):
            if turn >= least_rounds and time.monotonic() - begin > scale.group_s:
                break
            for case in cases if turn % 2 == 0 else cases[::-1]:
                # Taken before the study was interrupted.
                if taken[key_of(case)] > turn:
                    continue
                load = load_average()
                sample = measure(case)
                if sample is not None:
                    samples.add_sample(experiment.name, case, turn, sample, load=load, at=round(time.time(), 1))
    samples.add_done(experiment.name, group, scale.name)
