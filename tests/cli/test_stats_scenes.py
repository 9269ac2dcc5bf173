"""`clbvh stats` of scenes: both levels, as tables and as JSON, and refusals."""

from __future__ import annotations

import json

import pytest

from clbvh import build, make_shape, open_scene, sah_cost
from clbvh.builders.build import build_tree
from clbvh.builders.options import BuildOptions
from clbvh.cli import stats as scene_stats
from clbvh.layouts.device_arrays import measure_device_bytes
from clbvh.structs import INSTANCE

from .command import refuses, run_clbvh

SCENE = """
[[object]]
label = "knots"
shape = "knot"
triangles = 500
repeat = {grid = [4, 1, 2], spacing = [6, 0, 6]}

[[object]]
label = "stars"
spheres = "galaxy"
count = 300
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def read(*arguments):
    """Return the JSON object that a run printed, and check that it printed nothing else."""
    result = run_clbvh("stats", *arguments, "--json")
    assert (result.returncode, result.stderr) == (0, "")
    return json.loads(result.stdout)


def test_json_has_both_levels(scene):
    report = read(scene)
    assert report.keys() == {"scene", "build"}
    knots, stars = report["scene"]["geometries"]
    bvh = build(make_shape("knot", triangles=500))
    assert (knots["name"], knots["kind"], knots["instance_count"]) == ("knots", "triangles", 8)
    assert (knots["prim_count"], knots["node_count"], knots["depth"]) == (
        bvh.mesh.face_count,
        bvh.node_count,
        bvh.depth,
    )
    assert knots["sah_cost"] == sah_cost(bvh)
    assert knots["device_bytes"] == {layout: measure_device_bytes(bvh, layout) for layout in knots["device_bytes"]}
    shape = open_scene(scene)[0].geometries[1].shape
    spheres = build_tree(shape, "sah", None, BuildOptions())
    assert (stars["name"], stars["kind"], stars["instance_count"]) == ("stars", "spheres", 1)
    assert (stars["prim_count"], stars["node_count"]) == (300, spheres.node_count)
    assert stars["device_bytes"]["bvh8"] == measure_device_bytes(spheres, "bvh8")

    top = report["scene"]["instances"]
    # A leaf has one instance.
    assert (top["instance_count"], top["node_count"]) == (9, 17)
    assert 4 <= top["depth"] <= 8
    assert top["sah_cost"] > 1
    assert INSTANCE.itemsize < top["device_bytes_per_instance"] <= 256
    assert top["device_bytes"] == pytest.approx(9 * top["device_bytes_per_instance"])
    assert report["scene"]["prim_count"] == 8 * bvh.mesh.face_count + 300
    for layout, size in report["scene"]["device_bytes"].items():
        assert size == top["device_bytes"] + knots["device_bytes"][layout] + stars["device_bytes"][layout]


def test_options_reach_the_trees_of_the_geometries(scene):
    report = read(scene, "--leaf-size", 1, "--traversal-cost", 3, "--workers", 1)
    bvh = build(make_shape("knot", triangles=500), leaf_size=1, traversal_cost=3)
    assert report["scene"]["geometries"][0]["node_count"] == bvh.node_count
    assert report["scene"]["geometries"][0]["sah_cost"] == sah_cost(bvh, traversal_cost=3)
    assert (report["build"]["leaf_size"], report["build"]["workers"]) == (1, 1)


def test_a_builder_of_the_ladder_builds_the_geometries(scene):
    report = read(scene, "--builder", "median")
    assert report["build"]["builder"] == "median"
    assert (
        report["scene"]["geometries"][0]["node_count"]
        == build(make_shape("knot", triangles=500), builder="median").node_count
    )


def test_the_tables_have_both_levels(scene):
    result = run_clbvh("stats", scene)
    assert (result.returncode, result.stderr) == (0, "")
    for words in (
        "9 instances of 2 geometries",
        "300 spheres",
        "in a tree of 17 nodes",
        "bytes an instance",
        "as bvh8",
    ):
        assert words in result.stdout


def test_very_many_geometries_are_cut_short(scene, monkeypatch):
    monkeypatch.setattr(scene_stats, "_MOST_GEOMETRIES", 1)
    text = run_clbvh("stats", scene).stdout
    assert "the 1 largest geometries; --json has all of them" in text
    assert "knots" in text
    assert "stars" not in text
    monkeypatch.setattr(scene_stats, "_MOST_GEOMETRIES", 2)
    assert "largest geometries" not in run_clbvh("stats", scene).stdout


def test_the_rows_of_the_table_add_up_to_its_total(scene):
    times = read(scene)["build"]["timings_ms"]
    parts = sum(ms for phase, ms in times.items() if phase != "total")
    assert times["total"] == pytest.approx(parts)


@pytest.mark.parametrize("option", ["--exact", "--rays", "--plot"])
def test_measures_of_one_mesh_are_refused(scene, tmp_path, option):
    arguments = (option, tmp_path / "a.png") if option == "--plot" else (option,)
    refuses(run_clbvh("stats", scene, *arguments), 2, option, "one mesh", "several objects")
