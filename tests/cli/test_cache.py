"""`clbvh render --cache`: which trees are stored and taken, and the messages."""

from __future__ import annotations

import json

import pytest

from .command import run_clbvh

SCENE = '[[object]]\nshape = "knot"\ntriangles = 2000\n[view]\nup = "y"\nwidth = 32\nheight = 20\n'


@pytest.fixture
def render(tmp_path):
    """A function that renders the scene into a picture of its own, with the user's cache in the test's folder."""
    scene = tmp_path / "knot.toml"
    scene.write_text(SCENE)

    def run(*arguments, name="a.ppm"):
        return run_clbvh("render", scene, "-o", tmp_path / name, *arguments, CLBVH_CACHE=str(tmp_path / "cache"))

    return run


def test_the_second_run_takes_the_tree_of_the_first(render, tmp_path):
    reports = []
    for name in ("a.ppm", "b.ppm"):
        result = render("--cache", "--json", name=name)
        assert (result.returncode, result.stderr) == (0, "")
        reports.append(json.loads(result.stdout))
    assert [report["tree_from_cache"] for report in reports] == [False, True]
    assert [report["workers"] for report in reports] == [1, 0]
    assert [report["timings_ms"]["build"] > 0 for report in reports] == [True, False]
    for key in ("nodes", "depth", "sah_cost", "hits"):
        assert reports[0][key] == reports[1][key]
    assert (tmp_path / "a.ppm").read_bytes() == (tmp_path / "b.ppm").read_bytes()
    (tree,) = (tmp_path / "cache" / "trees").iterdir()
    assert tree.suffix == ".tree"


def test_the_table_says_where_the_tree_is_from(render):
    first, second, without = render("--cache"), render("--cache", "--validate"), render()
    assert "1 worker" in first.stdout
    assert "from the cache" in second.stdout
    assert "agree with the reference" in second.stdout
    assert "look the tree up in the cache" in second.stdout
    assert "cache" not in without.stdout


def test_without_the_option_nothing_is_kept_nor_taken(render, tmp_path):
    assert json.loads(render("--json").stdout)["tree_from_cache"] is False
    assert not (tmp_path / "cache").exists()
    render("--cache")
    assert json.loads(render("--json").stdout)["tree_from_cache"] is False


def test_another_folder_can_be_named(render, tmp_path):
    folder = tmp_path / "elsewhere"
    for expected in (False, True):
        assert json.loads(render("--cache-dir", folder, "--json").stdout)["tree_from_cache"] is expected
    assert len(list(folder.iterdir())) == 1
    assert not (tmp_path / "cache").exists()


def test_a_damaged_file_is_built_again_and_said(render, tmp_path):
    render("--cache", name="a.ppm")
    (tree,) = (tmp_path / "cache" / "trees").iterdir()
    tree.write_bytes(tree.read_bytes()[:1000])
    result = render("--cache", "--json", name="b.ppm")
    assert result.returncode == 0
    assert json.loads(result.stdout)["tree_from_cache"] is False
    (line,) = result.stderr.splitlines()
    assert line.startswith("clbvh: the tree in the cache cannot be used and is built again: ")
    assert str(tree) in line
    assert (tmp_path / "a.ppm").read_bytes() == (tmp_path / "b.ppm").read_bytes()
    assert json.loads(render("--cache", "--json").stdout)["tree_from_cache"] is True


def test_a_cache_that_cannot_be_is_wrong_usage(render, tmp_path):
    (tmp_path / "file").touch()
    result = render("--cache-dir", tmp_path / "file")
    assert (result.returncode, result.stdout) == (2, "")
    assert "trees cannot be kept in this folder" in result.stderr
    assert not (tmp_path / "a.ppm").exists()


def test_no_tree_needs_no_cache(render, tmp_path):
    report = json.loads(render("--builder", "brute", "--cache", "--json").stdout)
    assert (report["tree_from_cache"], report["timings_ms"]["cache"]) == (False, 0)
