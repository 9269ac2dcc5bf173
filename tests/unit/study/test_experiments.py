"""Every experiment, on meshes and pictures so small that all take seconds; the page that they make."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import clbvh.study
from clbvh.errors import ConfigError
from clbvh.study import engines, machine as machines
from clbvh.study.experiment import Experiment, curve
from clbvh.study.experiments import EXPERIMENTS, find_experiments, peers
from clbvh.study.page import Table
from clbvh.study.run import run_study
from clbvh.study.samples import Sample
from clbvh.study.scale import FULL, QUICK, SCANS, TINY, Scale

from .test_page import check_self_contained

ISSUED = [
    "ladder", "scaling", "threshold", "scenes", "resolution", "breakdown", "frontier", "layouts", "divergence",
    "counters", "peers", "devices", "gallery",
]  # fmt: skip


def test_the_experiments_are_those_of_the_report():
    assert list(EXPERIMENTS) == ISSUED


@pytest.mark.parametrize("name", ISSUED)
def test_each_experiment_has_its_texts(name):
    title, question, method = EXPERIMENTS[name].texts
    assert title
    assert question[-1] in ".?"
    assert method.endswith(".")


@pytest.mark.parametrize("scale", [FULL, QUICK, TINY], ids=lambda scale: scale.name)
@pytest.mark.parametrize("name", [name for name in ISSUED if name != "devices"])
def test_cases_differ_and_have_the_keys_of_their_group(name, scale):
    cases = EXPERIMENTS[name].cases(scale)
    assert len({str(sorted(case.items())) for case in cases}) == len(cases) > 0
    for case in cases:
        assert set(EXPERIMENTS[name].group) <= case.keys()


def test_the_contest_has_six_meshes_and_more():
    for scale in (FULL, QUICK):
        assert len({case["mesh"] for case in EXPERIMENTS["peers"].cases(scale)}) >= 6


def test_an_unknown_experiment_is_refused():
    with pytest.raises(ConfigError, match="there is no experiment 'ladders': take one of ladder, scaling"):
        find_experiments(["ladders"])


def test_a_missing_scan_is_replaced_by_a_procedural_mesh_of_its_size(monkeypatch, tmp_path):
    monkeypatch.setenv("CLBVH_MESHES", str(tmp_path))
    monkeypatch.setenv("CLBVH_CACHE", str(tmp_path))
    scale = Scale("test", 1, 1, 0, 0)
    assert scale.mesh("bunny") == f"knot-{SCANS['bunny']}"


def test_figures_of_the_report():
    assert curve("scaling.build_ms") == {1: 2687, 8: 570}
    assert curve("frontier.total_ms")[8192] == 1715


def test_no_figure_of_the_report_is_typed_into_an_experiment():
    """Figures with three digits and more, which are nobody's choice of a size or a number of cases."""
    text = Path(clbvh.study.__file__).with_name("report.toml").read_text()
    figures = {number for line in text.splitlines() if "=" in line and not line.startswith("#")
               for number in re.findall(r"\b\d+\.?\d+\b", line.partition("=")[2])}  # fmt: skip
    figures = {figure for figure in figures if len(figure.replace(".", "")) >= 3} - {"256", "450", "800"}
    assert "2687" in figures
    for path in Path(clbvh.study.__file__).parent.rglob("*.py"):
        # Sizes of the scans are needed to find stand-ins.
        source = "" if path.name == "scale.py" else path.read_text()
        numbers = set(re.findall(r"\b\d+\.?\d*\b", source.replace("_", "")))
        assert not numbers & figures, path


@pytest.fixture(scope="module")
def tiny(tmp_path_factory, _opened_device):
    """Return a whole tiny study, and its folder."""
    folder = tmp_path_factory.mktemp("study")
    return run_study(folder, scale=TINY), folder


def test_the_page_has_a_table_for_every_experiment(tiny):
    study, _ = tiny
    text = study.page.read_text("utf-8")
    page = check_self_contained(text)
    assert set(ISSUED) <= set(page.ids)
    for name in ISSUED:
        section = text[text.index(f'<section id="{name}">') :]
        assert "<table " in section[: section.index("</section>")], name


def test_every_time_has_its_samples(tiny):
    study, _ = tiny
    lines = study.samples.read_text().splitlines()
    assert sum('"kind": "sample"' in line for line in lines) > 100
    assert len(study.table.read_text().splitlines()) > len(lines)


def test_a_finished_study_measures_nothing_again(tiny, monkeypatch):
    study, folder = tiny
    before = study.samples.read_bytes()
    monkeypatch.setattr("clbvh.study.run.sample_group", None)
    assert run_study(folder, scale=TINY).samples.read_bytes() == before


def test_the_page_can_be_written_again_alone(tiny):
    study, folder = tiny
    before = study.page.read_bytes()
    study.page.unlink()
    assert run_study(folder, scale=TINY, only_page=True).page.read_bytes() == before


def test_another_version_is_noticed_and_nothing_is_mixed(tiny, monkeypatch, tmp_path):
    _, folder = tiny
    for path in folder.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    versions = {"numpy": "99.0", "matplotlib": "3", "Jinja2": "3"}
    monkeypatch.setattr(machines, "find_version", lambda package: versions.get(package))
    study = run_study(tmp_path, scale=TINY, only_page=True)
    (note,) = [note for note in study.notes if "another machine or version" in note]
    assert "and is 99.0" in note
    assert '<section id="ladder">' not in study.page.read_text()


@pytest.fixture
def no_engines():
    """The engines, none of them; afterwards all of them in their order, which tables follow."""
    every = dict(engines.ENGINES)
    engines.ENGINES.clear()
    yield engines.ENGINES
    engines.ENGINES.clear()
    engines.ENGINES.update(every)


@pytest.mark.usefixtures("_opened_device")
def test_a_missing_peer_is_named(tmp_path, no_engines):
    no_engines["ghost"] = type("Ghost", (engines.Engine,), {"name": "ghost", "packages": ("no_such_package",)})
    study = run_study(tmp_path, ["peers"], scale=TINY)
    assert "Missing peer: ghost (no_such_package is not installed)." in study.notes
    assert "no_such_package is not installed: run" in study.page.read_text()


def test_all_variants_draw_the_same_picture(tiny):
    study, _ = tiny
    text = study.page.read_text()
    ladder = text[text.index('<section id="ladder">') : text.index('<section id="scaling">')]
    assert ">yes<" in ladder
    assert ">NO<" not in ladder


def test_points_of_the_contest_are_near_the_mesh():
    mesh = clbvh.make_shape("knot", triangles=1000)
    generator = np.random.default_rng(0)
    points = peers._choose_points(mesh, 100, generator)
    extent = np.ptp(mesh.vertices, axis=0).max()
    assert points.shape == (100, 3)
    assert np.abs(points - mesh.origin).max() < extent
    origins, directions = peers._scatter(mesh, 50, generator)
    assert np.allclose(np.linalg.norm(origins - mesh.origin, axis=1), 2 * extent)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1)


@pytest.mark.usefixtures("_opened_device")
def test_the_experiment_of_the_documentation_runs(tmp_path, monkeypatch):
    text = (Path(__file__).parents[3] / "docs" / "study.md").read_text("utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names = {"Experiment": Experiment, "Sample": Sample, "Table": Table}
    exec(code, names)
    monkeypatch.setitem(EXPERIMENTS, "leaves", names["Leaves"]())
    page = run_study(tmp_path, ["leaves"], scale=TINY).page.read_text()
    assert '<section id="leaves">' in page
    assert "Build by leaf size." in page
