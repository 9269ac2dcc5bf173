"""A study: takes the samples that are missing, and writes the page."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import ConfigError
from ..support.atomic_file import write_atomically
from .case import Case, Experiment
from .machine import Machine, describe_machine, find_version, keep_machine
from .page.drawing import can_draw
from .page.html import Section, write_page
from .peers.engines import ENGINES
from .registry import find_experiments
from .report import TITLE
from .results import Results
from .sample_file import FILE_NAME, TABLE_NAME, SampleFile
from .sampling import group_cases, sample_group
from .scale import FULL, SCANS, Scale
from .statistics import NOISY_SPREAD

PAGE_NAME = "index.html"
PICTURES_NAME = "pictures"

NO_FIGURES = "matplotlib is not installed, so the page has tables and no figures: run 'pip install matplotlib'"

_NOISY = f"{100 * NOISY_SPREAD:.0f} %"

# Load averages above the number of cores and this share of them: something else was running.
_BUSY_SHARE = 1.5


@dataclass(frozen=True)
class Progress:
    """How far a study is.

    Attributes
    ----------
    experiment : str
    share : float
        Of the whole study, 0 to 1.
    remaining_s : float or None
        An estimate from the pace so far; None before anything is measured.
    """

    experiment: str
    share: float
    remaining_s: float | None


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
    on_progress: Callable[[Progress], None] = lambda progress: None,
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
        Called after each measurement.
    on_note : function, optional
        Called with each of the notes as soon as it is known.

    Returns
    -------
    Study

    Raises
    ------
    ConfigError
        There is no such experiment, the folder cannot be written to, or there are no samples for `only_page`.
    DeviceError
        There is no such device.
    """
    experiments = find_experiments(names)
    _make_folder(folder)
    if only_page and not (folder / FILE_NAME).is_file():
        raise ConfigError(f"{folder}: there are no samples in this folder, so there is no page to write: measure first")
    machine = describe_machine(device)
    changes = keep_machine(folder, machine)
    samples = SampleFile(folder, machine.digest)
    notes = _collect_notes(machine, changes, samples.others)
    for note in notes:
        on_note(note)

    if not only_page:
        watch = _Watch(experiments, scale, on_progress)
        for experiment in experiments:
            watch.begin(experiment)
            for group, cases in group_cases(experiment, experiment.cases(scale)).items():
                if not samples.is_done(experiment.name, group, scale.name):
                    sample_group(
                        experiment, group, cases, scale, machine, samples, folder / PICTURES_NAME,
                        watch.tick,
                    )  # fmt: skip
                watch.end_group(experiment, len(cases))

    table = samples.write_table()
    page = folder / PAGE_NAME
    content = make_page(find_experiments(()), samples, scale, machine, folder / PICTURES_NAME, notes)
    write_atomically(page, lambda file: file.write(content.encode()))
    return Study(page, folder / FILE_NAME, table, tuple(notes))


def make_page(
    experiments: Sequence[Experiment], samples: SampleFile, scale: Scale, machine: Machine, pictures: Path,
    notes: Sequence[str],
) -> str:  # fmt: skip
    """Return the page of all experiments that have samples."""
    sections = []
    for experiment in experiments:
        if samples.samples(experiment.name) or samples.failures(experiment.name):
            results = Results(experiment.name, samples, scale, machine.facts, experiment.cases(scale), pictures)
            if results.cases or results.failures:
                sections.append(_make_section(experiment, results))
    warm = f"{scale.least_rounds} to {scale.rounds} rounds" if scale.rounds > scale.least_rounds else "all rounds"
    introduction = [
        f"The experiments of the report “{TITLE}” (course project, 2026), repeated with clbvh on this machine, and a "
        "contest with other engines. Figures of the report stand beside ours, and were measured on other machines: "
        "compare shapes and ratios, not milliseconds.",
        f"How it is measured: one warm-up of each case that does not count, then {warm} in which the cases of a group "
        "take turns, forwards and backwards; median, with the smallest and the largest sample below it. Ratios are "
        f"medians of the ratios of each round. Figures whose samples lie more than {_NOISY} apart are marked by their "
        "colour, and counted as noisy. Wall time and the device's own event time are never mixed in one figure "
        "without saying so.",
        f"Size of this study: {scale.name}. Raw samples: {FILE_NAME} and {TABLE_NAME} beside this page.",
        *notes,
    ]
    facts = {**machine.facts, **_list_meshes(scale)}
    return write_page("The clbvh study", introduction, facts, sections)


def _make_section(experiment: Experiment, results: Results) -> Section:
    return Section(
        experiment.name, experiment.title, experiment.question, experiment.method,
        experiment.present(results) if results.cases else (),
        [*note_noise(experiment, results), *note_failures(results.failures)],
    )  # fmt: skip


def note_noise(experiment: Experiment, results: Results) -> list[str]:
    """Say how many figures are noisy, and whether the machine was busy with something else."""
    if experiment.counts or not results.cases:
        return []
    summaries = [
        summary
        for case in results.cases
        for quantity in results.quantities(case, "")
        if quantity.endswith("_ms") and (summary := results.summary(case, quantity)) is not None
    ]
    noisy = sum(summary.is_noisy for summary in summaries)
    notes = []
    if noisy:
        notes.append(f"Noise: {noisy} of {len(summaries)} measured times have samples more than {_NOISY} apart.")
    cores, load = results.cores, results.highest_load
    if load is not None and load > _BUSY_SHARE * cores + 1:
        notes.append(f"The machine was busy: the load average reached {load:g} on {cores} cores.")
    return notes


def note_failures(failures: Sequence[tuple[Case, str]]) -> list[str]:
    """Say what was not measured, cases of one reason together."""
    by_reason: dict[str, list[Case]] = {}
    for case, reason in failures:
        by_reason.setdefault(reason, []).append(case)
    notes = []
    for reason, cases in by_reason.items():
        # The values that all these cases share name them best.
        shared = {name: value for name, value in cases[0].items() if all(case.get(name) == value for case in cases)}
        named = ", ".join(f"{name} {value}" for name, value in shared.items())
        notes.append(f"Not measured, {len(cases)} case{'s' if len(cases) > 1 else ''} ({named}): {reason}.")
    return notes


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
        missing = [package for package in engine.packages if find_version(package) is None]
        if missing:
            notes.append(f"Missing peer: {name} ({', '.join(missing)} is not installed).")
    if not can_draw():
        notes.append(NO_FIGURES)
    return notes


def _list_meshes(scale: Scale) -> dict[str, str]:
    """Return what stands for the scans of the report that are missing."""
    stand_ins = {name: scale.mesh(name) for name in SCANS}
    return {
        f"instead of {name}": f"{mesh}, procedural: 'clbvh fetch {name}' brings the scan"
        for name, mesh in stand_ins.items()
        if mesh != name
    }


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: this folder cannot be created: {error.strerror or error}") from error


class _Watch:
    """Follows the measurements and estimates the remaining time from the pace so far."""

    def __init__(self, experiments: Sequence[Experiment], scale: Scale, report: Callable[[Progress], None]) -> None:
        self._report = report
        self._total = sum(experiment.weight for experiment in experiments)
        self._cases = {experiment.name: max(1, len(experiment.cases(scale))) for experiment in experiments}
        self._rounds = scale.rounds + 1
        self._finished = 0.0
        self._current = ""
        # The share that is done without having been measured now does not count for the pace.
        self._begin = time.monotonic()
        self._measured = 0.0
        self._ticks = 0

    def begin(self, experiment: Experiment) -> None:
        """Note that an experiment begins."""
        self._current = experiment.name
        self._weight = experiment.weight
        self._send(0.0)

    def tick(self) -> None:
        """Note a measurement."""
        self._ticks += 1
        part = self._weight * self._ticks / (self._cases[self._current] * self._rounds)
        self._send(part)

    def end_group(self, experiment: Experiment, case_count: int) -> None:
        """Note that a group of cases has all its samples."""
        part = experiment.weight * case_count / self._cases[experiment.name]
        self._finished += part
        if self._ticks:
            self._measured += part
        self._ticks = 0
        self._send(0.0)

    def _send(self, part: float) -> None:
        done = self._measured + part
        elapsed = time.monotonic() - self._begin
        left = max(0.0, self._total - self._finished - part)
        remaining_s = elapsed / done * left if done > 0 else None
        self._report(Progress(self._current, min(1.0, (self._finished + part) / self._total), remaining_s))
