"""The documents that quote a study: a page of all its tables, and the table in the README.

``python -m clbvh.study.publish out/study`` (`make results`) copies the samples of a study beside the documents and
writes both from them. A test writes them again from these samples, and compares: no figure in them can be typed in.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from ..errors import ConfigError
from ..support.atomic_file import write_atomically
from .experiments.peers import QUERIES, figure_of, lead_of
from .machine import FILE_NAME as MACHINES_NAME, read_machines
from .page.html import Section
from .page.markdown import wrap, write_markdown, write_table
from .page.parts import Table
from .registry import EXPERIMENTS
from .results import Results
from .run import note_failures, note_noise
from .sample_file import FILE_NAME as SAMPLES_NAME, SampleFile
from .scale import FULL, QUICK, TINY, Scale

RESULTS_NAME = "results.md"
SAMPLES_FOLDER = "results"
README_NAME = "README.md"
BEGIN, END = "<!-- study: begin -->", "<!-- study: end -->"

_SCALES = {scale.name: scale for scale in (FULL, QUICK, TINY)}


@dataclass(frozen=True)
class PublishedStudy:
    """The samples that documents quote, and the facts of their machine."""

    samples: SampleFile
    facts: dict[str, str]
    scale: Scale
    folder: Path

    def results(self, name: str) -> Results:
        """Return the results of an experiment."""
        return Results(name, self.samples, self.scale, self.facts, None, self.folder)


def open_study(folder: Path) -> PublishedStudy:
    """Return the latest study of a folder.

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
    names = {scale for experiment in EXPERIMENTS for scale in samples.scales(experiment)}
    if len(names) != 1:
        raise ConfigError(
            f"{folder}: the samples of this study are of {len(names)} sizes ({', '.join(sorted(names))}): documents "
            "need one study of one size, in a folder of its own"
        )
    return PublishedStudy(samples, machines[digest], _SCALES[names.pop()], folder)


def write_results(study: PublishedStudy) -> str:
    """Return the page of all tables."""
    sections = []
    for experiment in EXPERIMENTS.values():
        results = study.results(experiment.name)
        if results.cases:
            notes = [*note_noise(experiment, results), *note_failures(results.failures)]
            parts = experiment.present(results)
            sections.append(
                Section(experiment.name, experiment.title, experiment.question, experiment.method, parts, notes)
            )
    machine_table = Table("", ("machine", ""), [*study.facts.items()])
    return (
        "# Results of the study\n\n"
        f"Written by `make results` from the samples in [{SAMPLES_FOLDER}/]({SAMPLES_FOLDER}); do not edit. "
        f"Size: {study.scale.name}.\nMedians, with the smallest and the largest sample. [study.md](study.md) says how "
        "it is measured.\n\n"
        f"{write_table(machine_table)}\n\n{write_markdown(sections)}"
    )


def write_readme_table(study: PublishedStudy) -> str:
    """Return the part of the README between its two marks: the contest on every mesh, and in full on the largest."""
    results = study.results("peers")
    meshes = sorted(results.distinct("mesh"), key=lambda name: _triangles(results, name))
    engines = results.distinct("engine")
    leads, rows = [], []
    for query, title in QUERIES.items():
        by_mesh = [{str(case["engine"]): case for case in results.find(mesh=mesh, query=query)} for mesh in meshes]
        ratios = [lead_of(results, cases) if cases else None for cases in by_mesh]
        leads.append((title.removesuffix(", ms"), *(None if ratio is None else ratio.median for ratio in ratios)))
        if by_mesh[-1]:
            rows.append((title, *(figure_of(results, by_mesh[-1].get(name), query) for name in engines)))
    versions = [f"{name} {study.facts.get(name.lower(), study.facts['clbvh'])}" for name in engines]
    blocks = [
        f"Machine: {study.facts['cores']} cores of {study.facts['processor']}; {study.facts['device']}; "
        f"{', '.join(versions)}. Written by `make results` from docs/{SAMPLES_FOLDER}/; "
        f"[docs/{RESULTS_NAME}](docs/{RESULTS_NAME}) has all figures and says how they were measured.",
        "The time of the fastest other engine over clbvh's, whole calls, for meshes of growing size; above 1, clbvh is "
        "faster:",
        write_table(Table("", ("", *(f"{mesh}, {_triangles(results, mesh):,}" for mesh in meshes)), leads)),
        f"The largest of them, {meshes[-1]}. Build in ms, queries in millions of rays or points per second: medians, "
        "with the smallest and the largest sample.",
        write_table(Table("", ("", *engines), rows)),
    ]
    return "\n\n".join(block if block.startswith("|") else wrap(block) for block in blocks) + "\n"


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
    text = readme.read_text("utf-8")
    if BEGIN in text:
        _write(readme, replace_table(text, write_readme_table(study)).encode())


def replace_table(text: str, table: str) -> str:
    """Return a document with this table between its two marks."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{table}\n{END}{after}"


def _write(path: Path, content: bytes) -> None:
    write_atomically(path, lambda file: file.write(content))


def _triangles(results: Results, mesh: str) -> int:
    cases = results.find(mesh=mesh, query="build")
    return int(results.median(cases[0], "items") or 0) if cases else 0


def main(arguments: list[str]) -> None:
    """Publish the study of a folder into the project in this folder."""
    publish(Path(arguments[0]), Path.cwd())


if __name__ == "__main__":
    main(sys.argv[1:])
