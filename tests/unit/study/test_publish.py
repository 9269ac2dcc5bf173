"""Documents that quote a study: every figure comes from the samples that they name."""

from __future__ import annotations

from pathlib import Path

import pytest

from clbvh.errors import ConfigError
from clbvh.study.publish import (
    BEGIN,
    END,
    SAMPLES_FOLDER,
    draw_results,
    open_study,
    publish,
    write_readme_table,
    write_results,
)
from clbvh.study.run import run_study
from clbvh.study.scale import TINY

PROJECT = Path(__file__).parents[3]
DOCUMENTED = PROJECT / "docs" / SAMPLES_FOLDER


def find_wrong_documents(project):
    """Return the names of documents that differ from what their samples say."""
    study = open_study(project / "docs" / SAMPLES_FOLDER)
    wrong = []
    if (project / "docs" / "results.md").read_text("utf-8") != write_results(study):
        wrong.append("results.md")
    if draw_results(study).keys() != {path.name for path in (project / "docs" / SAMPLES_FOLDER).glob("*.svg")}:
        wrong.append("figures")
    readme = (project / "README.md").read_text("utf-8")
    if BEGIN in readme and write_readme_table(study).strip() != readme.partition(BEGIN)[2].partition(END)[0].strip():
        wrong.append("README.md")
    return wrong


@pytest.mark.skipif(not DOCUMENTED.is_dir(), reason="peers: no study is published in docs/")
def test_figures_of_the_documents_are_in_their_samples():
    assert find_wrong_documents(PROJECT) == []


@pytest.fixture
def project(tmp_path, _opened_device):
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text(f"# A\n\n{BEGIN}\nold\n{END}\n\n## B\n")
    run_study(tmp_path / "study", ["peers", "threshold"], scale=TINY)
    publish(tmp_path / "study", tmp_path)
    return tmp_path


def test_a_published_study_agrees_until_a_figure_is_changed(project):
    assert find_wrong_documents(project) == []
    readme, results = project / "README.md", project / "docs" / "results.md"
    assert readme.read_text().startswith(f"# A\n\n{BEGIN}\n")
    assert readme.read_text().endswith(f"{END}\n\n## B\n")
    assert "old" not in readme.read_text()
    assert "## Task threshold" in results.read_text()
    # Publishing again changes nothing.
    before = readme.read_bytes(), results.read_bytes()
    publish(project / "study", project)
    assert (readme.read_bytes(), results.read_bytes()) == before

    figure = next(word for word in results.read_text().split() if word.replace(".", "").isdigit() and "." in word)
    results.write_text(results.read_text().replace(figure, f"{figure}9", 1))
    assert find_wrong_documents(project) == ["results.md"]
    readme.write_text(readme.read_text().replace("| closest hit, coherent | ", "| closest hit, coherent | 9", 1))
    assert find_wrong_documents(project) == ["results.md", "README.md"]


def test_a_folder_without_a_study_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="there is no study in this folder"):
        open_study(tmp_path)
