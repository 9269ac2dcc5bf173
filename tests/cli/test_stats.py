"""`clbvh stats` of meshes and of scenes: the numbers, the tables, and what is missing."""

from __future__ import annotations

import json
import sys

import pytest
from PIL import Image

from clbvh import build, make_shape, measure_tree, sah_cost
from clbvh.device.select import choose_device
from clbvh.layouts.device_arrays import make_device_arrays
from clbvh.stats import tree_stats

from .command import hidden_drivers, refuses, run_clbvh, run_process

TIMING_KEYS = {"load", "build", "measure", "other", "total"}
KNOT = '[[object]]\nshape = "knot"\ntriangles = 2000\n'
OBJECTS = """
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
def knot_file(tmp_path):
    path = tmp_path / "knot.toml"
    path.write_text(KNOT)
    return path


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(OBJECTS)
    return path


@pytest.fixture(scope="module")
def knot():
    return make_shape("knot", triangles=2000)


def stats(*arguments):
    """Return the JSON object that a run printed, and check that it printed nothing else."""
    result = run_clbvh("stats", *arguments, "--json")
    assert (result.returncode, result.stderr) == (0, "")
    return json.loads(result.stdout)


def as_json(bvh, **options):
    return json.loads(json.dumps(measure_tree(bvh, **options).as_dict()))


class TestMesh:
    def test_json_has_the_measures_of_the_library(self, knot_file, knot):
        report = stats(knot_file)
        assert report.keys() == {"mesh", "build", "tree"}
        assert report["tree"] == as_json(build(knot))
        mesh = report["mesh"]
        assert (mesh["triangles"], mesh["vertices"]) == (knot.face_count, len(knot.vertices))
        assert (mesh["degenerate_triangles"], mesh["bytes"]) == (0, 12 * knot.face_count + 36 * len(knot.vertices))
        assert mesh["centre"] == knot.origin.tolist()
        assert mesh["size"] == pytest.approx((knot.vertices.max(axis=0) - knot.vertices.min(axis=0)).tolist())
        assert report["build"]["phases_ms"].keys() == build(knot).timings_ms.keys()
        assert report["build"]["timings_ms"].keys() == TIMING_KEYS

    def test_options_reach_the_build_and_the_measures(self, knot_file, knot):
        words = ("--leaf-size", 8, "--traversal-cost", 3, "--bins", 5, "--workers", 2, "--task-threshold", 100)
        report = stats(knot_file, *words)
        assert report["tree"] == as_json(build(knot, leaf_size=8, traversal_cost=3, bins=5), traversal_cost=3)
        expected = {"builder": "sah", "leaf_size": 8, "traversal_cost": 3, "bins": 5, "workers": 2}
        assert report["build"].items() >= (expected | {"task_threshold": 100}).items()
        report = stats(knot_file, "--quality", "fast")
        assert (report["tree"], report["build"]["quality"]) == (as_json(build(knot, quality="fast")), "fast")

    def test_a_device_builds_a_fast_tree_which_is_checked_on_demand(self, knot_file, knot):
        result = run_clbvh("stats", knot_file, "--quality", "fast", "--device", "cpu", "--validate")
        assert result.returncode == 0, result.stderr
        device = choose_device("cpu").name
        for words in (f"sah, quality fast, {device}, validated", "  merge", "validate", "check the tree"):
            assert words in result.stdout
        report = stats(knot_file, "--quality", "fast")["build"]
        assert (report["workers"], report["validated"]) == (0, False)
        assert report["phases_ms"].keys() == build(knot, quality="fast").timings_ms.keys()
        refuses(run_clbvh("stats", knot_file, "--quality", "fast", "--device", "nosuch"), 3, "'nosuch'")

    def test_the_tables_have_all_measures_and_add_up(self, knot_file, knot):
        measured = measure_tree(build(knot))
        result = run_clbvh("stats", knot_file, "--rays")
        assert (result.returncode, result.stderr) == (0, "")
        nodes = f"{measured.node_count:,}: {measured.interior_count:,} interior, {measured.leaf_count:,} leaves"
        for words in (nodes, f"{measured.sah_cost:.3f}", f"{measured.epo:.3f}", "sah, 1 worker", "surface rays"):
            assert words in result.stdout
        table = result.stdout[result.stdout.index("phase ") :].splitlines()[1:]
        outer = {line.split()[0]: float(line.split()[1].replace(",", "")) for line in table if line[0] != " "}
        assert outer.keys() == TIMING_KEYS | {"rays"}
        assert outer["total"] == pytest.approx(sum(outer.values()) - outer["total"], abs=0.5)

    def test_rays_are_counted_on_demand(self, knot_file):
        rays = stats(knot_file, "--rays")["rays"]
        assert rays.keys() == {"picture", "random", "surface"}
        for cost in rays.values():
            assert cost["tests"] == pytest.approx(cost["node_steps"] + cost["triangle_tests"])
            assert 0 < cost["hit"] < 1

    def test_a_large_mesh_is_sampled_unless_exact(self, knot_file, knot, monkeypatch):
        monkeypatch.setattr(tree_stats, "OVERLAP_SAMPLE", 1500)
        sampled, exact = stats(knot_file)["tree"], stats(knot_file, "--exact")["tree"]
        assert sampled["epo_triangles"] == 1500 < exact["epo_triangles"] == knot.face_count
        assert sampled["epo"] != exact["epo"]
        assert sampled["epo"] == pytest.approx(exact["epo"], rel=0.1)
        assert "on a sample of 1,500 triangles" in run_clbvh("stats", knot_file).stdout

    def test_a_plot_needs_matplotlib_and_nothing_a_device(self, knot_file, tmp_path, monkeypatch):
        stats(knot_file, "--plot", tmp_path / "a.png")
        with Image.open(tmp_path / "a.png") as image:
            assert image.size == (1500, 750)
        monkeypatch.setitem(sys.modules, "matplotlib", None)
        refuses(run_clbvh("stats", knot_file, "--plot", tmp_path / "a.png"), 2, "clbvh[study]")
        assert run_process("stats", knot_file, **hidden_drivers(tmp_path)).returncode == 0


class TestScene:
    def test_json_has_both_levels(self, scene):
        report = stats(scene)
        assert report.keys() == {"scene", "build"}
        knots, stars = report["scene"]["geometries"]
        bvh = build(make_shape("knot", triangles=500))
        assert (knots["name"], knots["kind"], knots["instance_count"]) == ("knots", "triangles", 8)
        parts = bvh.mesh.face_count, bvh.node_count, bvh.depth
        assert (knots["prim_count"], knots["node_count"], knots["depth"]) == parts
        assert knots["sah_cost"] == sah_cost(bvh)
        assert knots["device_bytes"] == {
            layout: make_device_arrays(bvh, layout).byte_count for layout in knots["device_bytes"]
        }
        assert (stars["name"], stars["kind"], stars["instance_count"]) == ("stars", "spheres", 1)
        assert stars["prim_count"] == 300
        top = report["scene"]["instances"]
        # A leaf has one instance.
        assert (top["instance_count"], top["node_count"]) == (9, 17)
        assert report["scene"]["prim_count"] == 8 * bvh.mesh.face_count + 300
        for layout, size in report["scene"]["device_bytes"].items():
            assert size == top["device_bytes"] + knots["device_bytes"][layout] + stars["device_bytes"][layout]
        text = run_clbvh("stats", scene).stdout
        for words in ("9 instances of 2 geometries", "300 spheres", "in a tree of 17 nodes", "bytes an instance"):
            assert words in text

    def test_options_reach_the_trees_of_the_geometries(self, scene):
        mesh = make_shape("knot", triangles=500)
        found = stats(scene, "--leaf-size", 1, "--traversal-cost", 3)["scene"]["geometries"][0]
        bvh = build(mesh, leaf_size=1, traversal_cost=3)
        assert (found["node_count"], found["sah_cost"]) == (bvh.node_count, sah_cost(bvh, traversal_cost=3))
