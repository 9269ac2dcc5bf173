"""`clbvh stats`: the numbers, the tables, and refusals."""

from __future__ import annotations

import json
import sys

import imageio.v3 as imageio
import pytest

from clbvh import build, make_shape, measure_tree
from clbvh.stats import tree_stats

from .command import hidden_drivers, refuses, run_clbvh, run_process

TIMING_KEYS = {"load", "build", "measure", "other", "total"}

SCENE = '[[object]]\nshape = "knot"\ntriangles = 2000\n'


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "knot.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def knot():
    return make_shape("knot", triangles=2000)


def read(result):
    """Return the JSON object that a run printed, and check that it printed nothing else."""
    assert (result.returncode, result.stderr) == (0, "")
    return json.loads(result.stdout)


def test_json_has_the_measures_of_the_library(scene, knot):
    report = read(run_clbvh("stats", scene, "--json"))
    assert report.keys() == {"mesh", "build", "tree"}
    assert report["tree"] == json.loads(json.dumps(measure_tree(build(knot)).as_dict()))
    mesh = report["mesh"]
    assert (mesh["triangles"], mesh["vertices"]) == (knot.face_count, len(knot.vertices))
    assert (mesh["degenerate_triangles"], mesh["bytes"]) == (0, 12 * knot.face_count + 36 * len(knot.vertices))
    assert mesh["centre"] == knot.origin.tolist()
    assert mesh["size"] == pytest.approx((knot.vertices.max(axis=0) - knot.vertices.min(axis=0)).tolist())
    assert report["build"]["phases_ms"].keys() == build(knot).timings_ms.keys()
    assert report["build"]["timings_ms"].keys() == TIMING_KEYS


def test_options_reach_the_build_and_the_measures(scene, knot):
    arguments = ("--leaf-size", 8, "--traversal-cost", 3, "--bins", 5, "--workers", 2, "--task-threshold", 100)
    report = read(run_clbvh("stats", scene, "--json", *arguments))
    expected = measure_tree(build(knot, leaf_size=8, traversal_cost=3, bins=5), traversal_cost=3)
    assert report["tree"] == json.loads(json.dumps(expected.as_dict()))
    made = report["build"]
    assert (made["builder"], made["leaf_size"], made["traversal_cost"], made["bins"]) == ("sah", 8, 3, 5)
    assert (made["workers"], made["task_threshold"]) == (2, 100)


def test_the_quality_reaches_the_build(scene, knot):
    report = read(run_clbvh("stats", scene, "--json", "--quality", "fast"))
    assert report["tree"] == json.loads(json.dumps(measure_tree(build(knot, quality="fast")).as_dict()))
    assert report["build"]["quality"] == "fast"


def test_the_tables_have_all_measures(scene, knot):
    stats = measure_tree(build(knot))
    result = run_clbvh("stats", scene)
    assert (result.returncode, result.stderr) == (0, "")
    for word in (
        f"{knot.face_count:,} triangles",
        f"{stats.node_count:,}: {stats.interior_count:,} interior, {stats.leaf_count:,} leaves",
        f"{stats.sah_cost:.3f}",
        f"{stats.epo:.3f}",
        f"{stats.host_bytes_per_triangle:.1f} bytes per triangle",
        "as bvh2",
        "sah, 1 worker",
        *build(knot).timings_ms,
    ):
        assert word in result.stdout
    for size, count in enumerate(stats.leaf_sizes):
        if count:
            assert f"{size}  " in result.stdout
            assert f"{count:,}" in result.stdout
    assert "sample" not in result.stdout


def test_the_rows_of_the_table_add_up_to_its_total(scene):
    result = run_clbvh("stats", scene, "--rays")
    table = result.stdout[result.stdout.index("phase ") :].splitlines()[1:]
    times = [(line.startswith(" "), line.split()[0], float(line.split()[1].replace(",", ""))) for line in table]
    outer = {phase: ms for is_part, phase, ms in times if not is_part}
    assert outer.keys() == TIMING_KEYS | {"rays"}
    assert outer["total"] == pytest.approx(sum(outer.values()) - outer["total"], abs=0.5)
    assert outer["build"] == pytest.approx(sum(ms for is_part, _, ms in times if is_part), abs=0.5)


def test_the_sample_is_as_large_as_the_help_says():
    words = " ".join(run_clbvh("stats", "--help", COLUMNS="200", NO_COLOR="1").stdout.split())
    assert f"not on at most {tree_stats.OVERLAP_SAMPLE:,}" in words


def test_a_large_mesh_is_sampled_unless_exact(scene, knot, monkeypatch):
    monkeypatch.setattr(tree_stats, "OVERLAP_SAMPLE", 1500)
    sampled = read(run_clbvh("stats", scene, "--json"))["tree"]
    exact = read(run_clbvh("stats", scene, "--json", "--exact"))["tree"]
    assert sampled["epo_triangles"] == 1500 < exact["epo_triangles"] == knot.face_count
    assert sampled["epo"] != exact["epo"]
    assert sampled["epo"] == pytest.approx(exact["epo"], rel=0.1)
    assert "on a sample of 1,500 triangles" in run_clbvh("stats", scene).stdout


def test_a_plot_is_written(scene, tmp_path):
    read(run_clbvh("stats", scene, "--json", "--plot", tmp_path / "a.png"))
    assert imageio.imread(tmp_path / "a.png").shape[:2] == (750, 1500)


def test_a_missing_matplotlib_is_named(scene, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = run_clbvh("stats", scene, "--plot", tmp_path / "a.png")
    refuses(result, 2, "pip install matplotlib")
    assert run_clbvh("stats", scene).returncode == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--plot", "a.pdf"), ("a.pdf", ".png")),
        (("--plot", "gone/a.png"), ("does not exist",)),
        (("--builder", "brute"), ("builder", "brute")),
        (("--bins", "1"), ("bins", "1")),
        (("--quality", "best"), ("quality", "best")),
        (("--workers", "0"), ("workers", "0")),
        (("--traversal-cost", "0"), ("traversal_cost", "0")),
    ],
)
def test_options_out_of_range_are_wrong_usage(scene, arguments, words):
    refuses(run_clbvh("stats", scene, *arguments), 2, *words)


def test_a_missing_mesh_is_bad_input(tmp_path):
    refuses(run_clbvh("stats", tmp_path / "gone.ply"), 2, "gone.ply", "no such file")


def test_no_device_is_needed(scene, tmp_path):
    assert run_process("stats", scene, **hidden_drivers(tmp_path)).returncode == 0


def test_rays_are_counted_on_demand(scene, knot):
    report = read(run_clbvh("stats", scene, "--json", "--rays"))
    assert report.keys() == {"mesh", "build", "tree", "rays"}
    assert report["rays"].keys() == {"picture", "random", "surface"}
    for cost in report["rays"].values():
        assert cost["tests"] == pytest.approx(cost["node_steps"] + cost["triangle_tests"])
        assert 0 < cost["hit"] < 1
    assert "rays" in report["build"]["timings_ms"]
    high = read(run_clbvh("stats", scene, "--json", "--rays", "--quality", "high"))
    assert high["rays"]["random"]["tests"] < report["rays"]["random"]["tests"]
    shown = run_clbvh("stats", scene, "--rays").stdout
    for kind, cost in report["rays"].items():
        assert f"{kind} rays" in shown
        assert f"{cost['tests']:.2f} tests: {cost['node_steps']:.2f} node steps" in shown
