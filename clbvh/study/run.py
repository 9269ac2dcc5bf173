"""A study: takes the samples that are missing, and writes the page."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from ..errors import ClbvhError, ConfigError
from ..support.files import write_atomically
from .bench import Bench
from .engines import ENGINES
from .experiment import Experiment
from .experiments import EXPERIMENTS, find_experiments
from .machine import Machine, describe_machine, keep_machine, list_missing
from .page import HTML, render
from .samples import FILE_NAME, TABLE_NAME, Case, NotMeasuredError, Results, SampleFile, key_of
from .scale import FULL, SCANS, Scale

PAGE_NAME = "index.html"
PICTURES_NAME = "pictures"

# The round before the first, which does not count.
_WARM_UP = -1

_PACKAGES = ("matplotlib", "Jinja2")


@dataclass(frozen=True)
class Study:
    """A finished study.

    Attributes
    ----------
    page : Path
    samples, table : Path
        All raw samples as JSON lines and as CSV.
    notes : tuple of str
        What a reader should know before the figures: missing peers, another machine before.
    """

    page: Path
    samples: Path
    table: Path
    notes: tuple[str, ...]


def run_study(
    folder: Path,
    names: Sequence[str] = (),
    *,
    scale: Scale = FULL,
    device: str | None = None,
    only_page: bool = False,
    on_progress: Callable[[str, float], None] = lambda experiment, share: None,
    on_note: Callable[[str], None] = lambda note: None,
) -> Study:
    """Run experiments, keep each sample as it is taken, and write the page.

    Parameters
    ----------
    folder : Path
        Gets the samples and the page; created if it is missing. Samples that are there already, of the same machine
        and versions, are not taken again: so an interrupted study goes on.
    names : sequence of str, optional
        The experiments to run; all without it. The page shows all that have samples.
    scale : Scale, optional
    device : str, optional
        The OpenCL device to measure; see `clbvh.Tracer`.
    only_page : bool, optional
        Measure nothing, and write the page from the samples that are there.
    on_progress : function, optional
        Called before and after each measurement with the experiment's name and the share of the missing measurements
        that is made, 0 to 1.
    on_note : function, optional
        Called with each of the notes as soon as it is known.

    Returns
    -------
    Study

    Raises
    ------
    ConfigError
        There is no such experiment, the folder cannot be written to, there are no samples for `only_page`, or
        matplotlib or Jinja2 is missing.
    DeviceError
        There is no such device.
    """
    experiments = find_experiments(names)
    if missing := list_missing(_PACKAGES):
        raise ConfigError(f"the page of a study needs {missing}: run 'pip install \"clbvh[study]\"'")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: this folder cannot be created: {error.strerror or error}") from error
    if only_page and not (folder / FILE_NAME).is_file():
        raise ConfigError(f"{folder}: there are no samples in this folder, so there is no page to write: measure first")
    machine = describe_machine(device)
    changes = keep_machine(folder, machine)
    samples = SampleFile(folder, machine.digest)
    notes = _collect_notes(machine, changes, samples.others)
    for note in notes:
        on_note(note)

    if not only_page:
        take_samples(experiments, scale, machine, samples, folder / PICTURES_NAME, on_progress)
    table = samples.write_table()
    page = folder / PAGE_NAME
    content = _make_page(samples, scale, machine, folder / PICTURES_NAME, notes)
    write_atomically(page, lambda file: file.write(content.encode()))
    return Study(page, folder / FILE_NAME, table, tuple(notes))


def take_samples(
    experiments: Sequence[Experiment], scale: Scale, machine: Machine, samples: SampleFile, pictures: Path,
    on_progress: Callable[[str, float], None] = lambda experiment, share: None,
) -> None:  # fmt: skip
    """Sample the groups that are not done, and report the weight of the measurements made."""
    to_do = []
    for experiment in experiments:
        cases = experiment.cases(scale)
        for group, members in group_cases(experiment, cases).items():
            if not samples.is_done(experiment.name, group, scale.name):
                to_do.append((experiment, group, members, experiment.weight * len(members) / len(cases)))
    total = sum(weight for *_, weight in to_do)
    finished = 0.0
    for experiment, group, members, weight in to_do:
        on_progress(experiment.name, finished / total)
        measurements = len(members) * (scale.rounds + 1)
        for count, _ in enumerate(sample_group(experiment, group, members, scale, machine, samples, pictures), start=1):
            on_progress(experiment.name, (finished + weight * count / measurements) / total)
        finished += weight


def group_cases(experiment: Experiment, cases: list[Case]) -> dict[str, list[Case]]:
    """Return the cases by groups that are measured together."""
    groups: dict[str, list[Case]] = {}
    for case in cases:
        groups.setdefault(key_of({name: case[name] for name in experiment.group}), []).append(case)
    return groups


def sample_group(
    experiment: Experiment, group: str, cases: list[Case], scale: Scale, machine: Machine, samples: SampleFile,
    pictures: Path,
) -> Iterator[None]:  # fmt: skip
    """Take the samples that a group of cases lacks, and yield after each measurement, counted or not.

    Every case is measured once without counting it: compiled code, caches and worker pools are warm then. In each
    round all cases take their turn, forwards and backwards by turns, so that a drift of the machine's speed meets all
    of them. A case that cannot be measured does not stop the others.
    """
    rounds, least_rounds = (1, 1) if experiment.counts else (scale.rounds, scale.least_rounds)
    taken = {key_of(case): samples.count(experiment.name, case) for case in cases}
    with Bench(scale, machine, pictures) as bench:
        for turn in range(0 if experiment.counts else _WARM_UP, rounds):
            if turn == 0:
                begin = time.monotonic()
            if turn >= least_rounds and time.monotonic() - begin > scale.group_s:
                break
            for case in cases if turn % 2 == 0 else cases[::-1]:
                # Taken before the study was interrupted, or failed.
                if turn != _WARM_UP and taken[key_of(case)] > turn:
                    continue
                load = round(psutil.getloadavg()[0], 2)
                try:
                    sample = experiment.measure(bench, case)
                except (NotMeasuredError, ClbvhError, MemoryError) as error:
                    taken[key_of(case)] = rounds
                    samples.add_failure(experiment.name, case, str(error) or type(error).__name__)
                else:
                    if turn != _WARM_UP:
                        samples.add_sample(experiment.name, case, turn, sample, load=load, at=round(time.time(), 1))
                yield
    samples.add_done(experiment.name, group, scale.name)


def _make_page(samples: SampleFile, scale: Scale, machine: Machine, pictures: Path, notes: Sequence[str]) -> str:
    """Return the page of all experiments that have samples."""
    sections = []
    for experiment in EXPERIMENTS.values():
        results = Results(experiment.name, samples, scale, machine.facts, experiment.cases(scale), pictures)
        if results.cases or results.failures:
            sections.append(experiment.make_section(results))
    rounds = f"{scale.least_rounds} to {scale.rounds} rounds" if scale.rounds > scale.least_rounds else "all rounds"
    stand_ins = {
        f"instead of {name}": f"{mesh}, procedural: 'clbvh fetch {name}' brings the scan"
        for name in SCANS
        if (mesh := scale.mesh(name)) != name
    }
    return render(
        HTML, machine={**machine.facts, **stand_ins}, sections=sections, notes=notes, rounds=rounds, size=scale.name,
        samples=FILE_NAME, table=TABLE_NAME,
    )  # fmt: skip


def _collect_notes(machine: Machine, changes: Sequence[str], others: int) -> list[str]:
    notes = []
    if machine.device is None:
        notes.append(f"No OpenCL device is measured: {machine.problem}")
    if changes:
        notes.append(
            "This is another machine or version than that of the study before in this folder, whose samples are kept "
            f"but not shown: {'; '.join(changes)}."
        )
    elif others:
        notes.append(f"{others} samples of other machines or versions are in the folder and are not shown.")
    for name, engine in ENGINES.items():
        if missing := list_missing(engine.packages):
            notes.append(f"Missing peer: {name} ({missing} is not installed).")
    return notes
