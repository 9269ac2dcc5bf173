"""A whole study, each experiment by one case of its group on tiny meshes: its page, and the documents that quote it."""

from __future__ import annotations

import dataclasses
import re
from functools import partial
from pathlib import Path

import pytest

from clbvh import ConfigError
from clbvh.study import machine as machines
from clbvh.study.experiment import Experiment
from clbvh.study.experiments import EXPERIMENTS, find_experiments
from clbvh.study.page import Table
from clbvh.study.publish import (
    BEGIN,
    END,
    SAMPLES_FOLDER,
    open_study,
    publish,
    write_readme_table,
    write_results,
)
from clbvh.study.run import run_study
from clbvh.study.samples import Sample
from clbvh.study.scale import FULL, QUICK, TINY

from .test_page import check_self_contained

PROJECT = Path(__file__).parents[3]
DOCUMENTED = PROJECT / "docs" / SAMPLES_FOLDER
SMALL = dataclasses.replace(TINY, rounds=1, least_rounds=1)


@pytest.fixture(scope="module")
def study(tmp_path_factory, _opened_device):
    """A finished study of the first case of all experiments, of the contest those of our own engine; and its folder."""
    folder = tmp_path_factory.mktemp("study")

    def first_cases(scale, *, whole, is_contest):
        return [case for case in whole(scale) if case["engine"] == "clbvh"] if is_contest else whole(scale)[:1]

    with pytest.MonkeyPatch.context() as patch:
        for name, experiment in EXPERIMENTS.items():
            patch.setattr(experiment, "cases", partial(first_cases, whole=experiment.cases, is_contest=name == "peers"))
        yield run_study(folder, scale=SMALL), folder


def test_cases_differ_and_have_the_keys_of_their_group():
    for name, experiment in EXPERIMENTS.items():
        title, question, method = experiment.texts
        assert title and question[-1] in ".?" and method.endswith("."), name  # noqa: PT018
        for scale in (FULL, QUICK, TINY) if name != "devices" else ():
            cases = experiment.cases(scale)
            assert len({str(sorted(case.items())) for case in cases}) == len(cases) > 0
            assert all(set(experiment.group) <= case.keys() for case in cases), name
    with pytest.raises(ConfigError, match="there is no experiment 'ladders': take one of ladder, trees, scaling"):
        find_experiments(["ladders"])


def test_a_page_has_all_experiments_and_a_finished_study_measures_nothing_again(study, monkeypatch):
    study, folder = study
    text, samples = study.page.read_text("utf-8"), study.samples.read_text()
    assert set(EXPERIMENTS) <= set(check_self_contained(text).ids)
    for name in EXPERIMENTS:
        assert "<table " in text.partition(f'<section id="{name}">')[2].partition("</section>")[0], name
        assert f'"experiment": "{name}"' in samples
    assert len(study.table.read_text().splitlines()) > len(samples.splitlines())
    monkeypatch.setattr("clbvh.study.run.sample_group", None)
    assert run_study(folder, scale=SMALL).samples.read_text() == samples
    study.page.unlink()
    assert run_study(folder, scale=SMALL, only_page=True).page.read_text("utf-8") == text


def test_another_version_is_noticed_and_nothing_is_mixed(study, monkeypatch, tmp_path):
    for path in study[1].glob("*.json*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    versions = {"numpy": "99.0", "matplotlib": "3", "Jinja2": "3"}
    monkeypatch.setattr(machines, "find_version", versions.get)
    again = run_study(tmp_path, scale=SMALL, only_page=True)
    (note,) = [note for note in again.notes if "another machine or version" in note]
    assert "and is 99.0" in note
    assert '<section id="ladder">' not in again.page.read_text()


@pytest.mark.usefixtures("_opened_device")
def test_the_experiment_of_the_documentation_runs(tmp_path, monkeypatch):
    text = (PROJECT / "docs" / "study.md").read_text("utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names = {"Experiment": Experiment, "Sample": Sample, "Table": Table}
    exec(code, names)
    monkeypatch.setitem(EXPERIMENTS, "leaves", names["Leaves"]())
    page = run_study(tmp_path, ["leaves"], scale=SMALL).page.read_text()
    assert '<section id="leaves">' in page
    assert "Build by leaf size." in page


def find_wrong_documents(project):
    """Return the names of documents that differ from what their samples say."""
    study, docs = open_study(project / "docs" / SAMPLES_FOLDER), project / "docs"
    wrong = []
    if (docs / "results.md").read_text("utf-8") != write_results(study):
        wrong.append("results.md")
    readme = (project / "README.md").read_text("utf-8")
    if BEGIN in readme and write_readme_table(study).strip() != readme.partition(BEGIN)[2].partition(END)[0].strip():
        wrong.append("README.md")
    return wrong


@pytest.mark.skipif(not DOCUMENTED.is_dir(), reason="peers: no study is published in docs/")
def test_figures_of_the_documents_are_in_their_samples():
    assert find_wrong_documents(PROJECT) == []


def test_a_published_study_agrees_until_a_figure_is_changed(study, tmp_path):
    (tmp_path / "docs").mkdir()
    readme, results = tmp_path / "README.md", tmp_path / "docs" / "results.md"
    readme.write_text(f"# A\n\n{BEGIN}\nold\n{END}\n\n## B\n")
    publish(study[1], tmp_path)
    assert find_wrong_documents(tmp_path) == []
    assert re.fullmatch(f"# A\n\n{BEGIN}\n.*{END}\n\n## B\n", readme.read_text(), re.DOTALL)
    assert "old" not in readme.read_text()
    figure = next(word for word in results.read_text().split() if re.fullmatch(r"\d+\.\d+", word))
    results.write_text(results.read_text().replace(figure, f"{figure}9", 1))
    readme.write_text(readme.read_text().replace(BEGIN, f"{BEGIN}9", 1))
    assert find_wrong_documents(tmp_path) == ["results.md", "README.md"]
    with pytest.raises(ConfigError, match="there is no study in this folder"):
        open_study(tmp_path)
