"""The documents that quote a study: a page of all its tables, and the table in the README.

``python -m clbvh.study.publish out/study`` (`make results`) copies the samples of a study beside the documents and
writes both from them. A test writes them again from these samples, and compares: no figure in them can be typed in.
"""

from __future__ import annotations

import sys
from pathlib import Path

from ..errors import ConfigError
from ..support.files import write_atomically
from .experiment import count_noisy
from .experiments import EXPERIMENTS
from .experiments.peers import list_leads
from .machine import FILE_NAME as MACHINES_NAME, read_machines
from .page import README, RESULTS, render
from .samples import FILE_NAME as SAMPLES_NAME, Results, SampleFile
from .scale import FULL, QUICK, TINY

RESULTS_NAME = "results.md"
SAMPLES_FOLDER = "results"
README_NAME = "README.md"
BEGIN, END = "<!-- study: begin -->", "<!-- study: end -->"


def open_study(folder: Path) -> dict[str, Results]:
    """Return the results of the latest study of a folder, by experiment.

    Raises
    ------
    ConfigError
        There is none.
    """
    machines = read_machines(folder)
    if not machines:
        raise ConfigError(f"{folder}: there is no study in this folder: run 'clbvh study -o {folder}'")
    *_, digest = machines
    samples = SampleFile(folder, digest)
    scales = [scale for scale in (FULL, QUICK, TINY) if scale.name in samples.scales()]
    if len(scales) != 1:
        raise ConfigError(f"{folder}: documents need one study of one size, in a folder of its own, not {len(scales)}")
    return {name: Results(name, samples, scales[0], machines[digest], None, folder) for name in EXPERIMENTS}


def write_results(study: dict[str, Results]) -> str:
    """Return the page of all tables."""
    machine, size = study["peers"].machine, study["peers"].scale.name
    sections = [EXPERIMENTS[name].make_section(results) for name, results in study.items() if results.cases]
    noisy, count = map(sum, zip(*(count_noisy(results) for results in study.values()), strict=True))
    return render(
        RESULTS, machine=machine, sections=sections, folder=SAMPLES_FOLDER, size=size, noisy=noisy, count=count,
    )  # fmt: skip


def write_readme_table(study: dict[str, Results]) -> str:
    """Return the part of the README between its two marks: the leads in the contest on every mesh."""
    results, facts = study["peers"], study["peers"].machine
    versions = ", ".join(f"{name} {facts.get(name.lower(), facts['clbvh'])}" for name in results.distinct("engine"))
    return render(
        README, machine=facts, versions=versions, folder=SAMPLES_FOLDER, results=RESULTS_NAME,
        leads=list_leads(results, ""),
    )  # fmt: skip


def publish(source: Path, project: Path) -> None:
    """Copy a study's samples into a project's documents, and write the documents from them.

    Parameters
    ----------
    source : Path
        The folder of a study.
    project : Path
        Has README.md and docs/.
    """
    open_study(source)
    target = project / "docs" / SAMPLES_FOLDER
    target.mkdir(exist_ok=True)
    *_, digest = read_machines(source)
    lines = [line for line in (source / SAMPLES_NAME).read_bytes().splitlines() if digest.encode() in line]
    _write(target / SAMPLES_NAME, b"\n".join(lines) + b"\n")
    _write(target / MACHINES_NAME, (source / MACHINES_NAME).read_bytes())
    study = open_study(target)
    _write(project / "docs" / RESULTS_NAME, write_results(study).encode())
    readme = project / README_NAME
    before, begin, rest = readme.read_text("utf-8").partition(BEGIN)
    if begin:
        _, _, after = rest.partition(END)
        _write(readme, f"{before}{BEGIN}\n\n{write_readme_table(study)}\n{END}{after}".encode())


def _write(path: Path, content: bytes) -> None:
    write_atomically(path, lambda file: file.write(content))


if __name__ == "__main__":
    # Publishes the study of a folder into the project in this folder.
    publish(Path(sys.argv[1]), Path.cwd())
