"""`clbvh render`: pictures, tables, JSON objects and files of hits, of meshes and of scenes."""

import json
import os
import pty
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

import clbvh

from .command import make_environment, refuses, run_clbvh

SIZE = ("--width", 48, "--height", 36)
TETRAHEDRON = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
REPORT_KEYS = {
    "triangles", "nodes", "depth", "sah_cost", "tree_from_cache", "workers", "device", "layout", "width", "height",
    "rays", "hits", "mrays_per_s", "timings_ms",
}  # fmt: skip
TIMING_KEYS = {
    "start", "load", "cache", "build", "open", "layout", "compile", "upload", "kernel", "download",
    "other", "total", "write",
}  # fmt: skip
SCENE = """
[view]
up = "y"
width = 48
height = 36

[[object]]
label = "floor"
shape = "terrain"
triangles = 50
height = 0.2

[[object]]
label = "tree"
shape = "icosphere"
triangles = 20
scale = 0.4
repeat = {on = "floor", count = 8, seed = 1}

[[object]]
label = "stars"
centres = [[0, 2, 0], [1, 2, 0]]
radii = 0.4
"""


@pytest.fixture
def mesh(tmp_path):
    path = tmp_path / "tetrahedron.off"
    path.write_text(TETRAHEDRON)
    return path


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def read(path):
    with Image.open(path) as image:
        return np.asarray(image)


def render(*arguments, folder):
    """Return the report of a picture and its hits file."""
    hits = folder / "hits.npz"
    result = run_clbvh("render", *arguments, "-o", folder / "out.ppm", "--hits", hits, "--json", "--up", "0,1,0", *SIZE)
    assert (result.returncode, result.stderr) == (0, "")
    with np.load(hits) as arrays:
        return json.loads(result.stdout), dict(arrays)


def test_a_mesh_becomes_pictures_and_a_table_that_adds_up(mesh, tmp_path):
    files = ("-o", tmp_path / "a.ppm", "-o", tmp_path / "a.png")
    result = run_clbvh("render", mesh, *files, "--validate", "--workers", 2, "--up", "0,1,0")
    assert (result.returncode, result.stderr) == (0, "")
    picture = read(tmp_path / "a.ppm")
    assert picture.shape == (450, 800, 3)
    np.testing.assert_array_equal(picture, read(tmp_path / "a.png"))
    for words in ("tetrahedron.off, 4 triangles", "SAH cost", "800 x 450", "tree and 360,000 pixels agree with the"):
        assert words in result.stdout
    table = result.stdout[result.stdout.index("phase ") :].splitlines()[1:]
    times = {line.split()[0]: float(line.split()[1].replace(",", "")) for line in table}
    assert times.keys() == TIMING_KEYS - {"cache"}
    parts = [ms for phase, ms in times.items() if phase != "total"]
    assert sum(parts) == pytest.approx(times["total"], abs=0.05 * (len(parts) + 1))


def test_hits_and_json_of_one_mesh_agree(mesh, tmp_path):
    report, hits = render(mesh, folder=tmp_path)
    assert report.keys() >= REPORT_KEYS
    assert report["timings_ms"].keys() == TIMING_KEYS
    assert (report["triangles"], report["width"], report["height"], report["rays"]) == (4, 48, 36, 48 * 36)
    by_pixel = ("t", "u", "v", "prim_id", "geometry_id", "instance_id")
    assert {hits[name].shape for name in by_pixel} == {(36, 48)}
    is_hit = hits["prim_id"] >= 0
    assert 0 < is_hit.sum() == report["hits"] < report["rays"]
    np.testing.assert_array_equal(np.isfinite(hits["t"]), is_hit)


def test_an_empty_scene_needs_a_camera(tmp_path):
    clbvh.Scene().save(tmp_path / "empty.scene")
    words = "render", tmp_path / "empty.scene", "-o", tmp_path / "a.png", *SIZE
    refuses(run_clbvh(*words), 2, "nothing that a camera could frame")
    result = run_clbvh(*words, "--eye", "0,0,5", "--look-at", "0,0,0")
    assert (result.returncode, "0 of 1,728 rays hit" in result.stdout) == (0, True)
    refuses(run_clbvh("stats", tmp_path / "empty.scene"), 2, "the scene is empty")


def test_several_meshes_and_their_parts_are_named(mesh, tmp_path):
    (tmp_path / "steps.obj").write_text(
        "o low\nv 2 0 0\nv 3 0 0\nv 2 1 0\nf 1 2 3\no high\nv 2 1 1\nv 3 1 1\nv 2 2 1\nf 4 5 6\n"
    )
    report, hits = render(mesh, tmp_path / "steps.obj", folder=tmp_path)
    assert (report["instances"], report["geometries"]) == (2, 2)
    assert hits["instance_names"].tolist() == ["tetrahedron", "steps"]
    assert hits["part_names"].tolist() == ["low", "high"]
    assert set(np.unique(hits["part_id"])) == {-1, 0, 1}


def test_the_hits_of_a_scene_name_its_objects(scene, tmp_path):
    report, hits = render(scene, folder=tmp_path)
    assert hits["geometry_names"].tolist() == ["floor", "tree", "stars"]
    trees = ["tree", *(f"tree {number}" for number in range(2, 9))]
    assert hits["instance_names"].tolist() == ["floor", *trees, "stars"]
    is_hit = hits["instance_id"] >= 0
    geometry_of = np.array([0] + 8 * [1] + [2])
    np.testing.assert_array_equal(hits["geometry_id"][is_hit], geometry_of[hits["instance_id"][is_hit]])
    assert set(np.unique(hits["geometry_id"])) == {-1, 0, 1, 2}
    assert (report["geometries"], report["instances"], report["spheres"]) == (3, 10, 2)
    # From above, the stars are in the middle of the floor.
    assert render(scene, "--eye", "0,9,0.1", "--look-at", "0,0,0", folder=tmp_path)[1]["instance_id"][18, 24] == 9


class TestKeptTrees:
    @pytest.fixture
    def draw(self, mesh, tmp_path):
        """A function that renders the mesh, with the user's cache in the test's folder, and returns the report."""

        def run(*arguments, note=""):
            words = ("render", mesh, "-o", tmp_path / "a.ppm", *SIZE, "--up", "0,1,0", "--json", *arguments)
            answer = run_clbvh(*words, CLBVH_CACHE=str(tmp_path / "cache"))
            assert answer.returncode == 0
            assert note in answer.stderr if note else answer.stderr == ""
            return json.loads(answer.stdout)

        return run

    def test_a_second_run_takes_the_tree_of_the_first(self, draw, tmp_path):
        assert draw()["tree_from_cache"] is False
        assert not (tmp_path / "cache").exists()
        first = draw("--cache")
        picture = (tmp_path / "a.ppm").read_bytes()
        second = draw("--cache")
        assert [report["tree_from_cache"] for report in (first, second)] == [False, True]
        assert all(first[key] == second[key] for key in ("nodes", "depth", "sah_cost", "hits"))
        assert (tmp_path / "a.ppm").read_bytes() == picture
        (tree,) = (tmp_path / "cache" / "trees").iterdir()
        # A damaged file is built again, and said.
        tree.write_bytes(tree.read_bytes()[:100])
        note = f"clbvh: the tree in the cache cannot be used and is built again: {tree}"
        assert draw("--cache", note=note)["tree_from_cache"] is False
        assert draw("--cache")["tree_from_cache"] is True

    def test_another_folder_can_be_named(self, draw, scene, tmp_path):
        folder = tmp_path / "elsewhere"
        for expected in (False, True):
            assert draw("--cache-dir", folder)["tree_from_cache"] is expected
        assert not (tmp_path / "cache").exists()
        # Those of all geometries of a scene.
        words = ("render", scene, "-o", tmp_path / "a.ppm", "--cache-dir", folder)
        assert ["from the cache" in run_clbvh(*words).stdout for _ in range(2)] == [False, True]
        assert len(list(folder.iterdir())) == 1 + 3


class TestSamples:
    WORDS = ("--width", 40, "--height", 30)

    def test_a_short_time_takes_one_sample_at_least(self, scene, tmp_path):
        for more in ((), ("--samples", 1_000_000)):
            answer = run_clbvh("render", scene, "-o", tmp_path / "a.png", *SIZE, "--time", 0.01, "--json", *more)
            assert (answer.returncode, answer.stderr) == (0, "")
            assert 1 <= json.loads(answer.stdout)["samples"] < 1_000_000

    def test_a_terminal_shows_the_progress(self, mesh, tmp_path):
        main, terminal = pty.openpty()
        words = ["render", mesh, "-o", tmp_path / "a.png", *self.WORDS, "--time", 2]
        process = subprocess.Popen(
            [sys.executable, "-c", "from clbvh.cli import main; main()", *map(str, words)],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=terminal, env=make_environment(TERM="xterm"),
        )  # fmt: skip
        os.close(terminal)
        shown = b""
        try:
            while part := os.read(main, 4096):
                shown += part
        except OSError:  # Linux's end of a terminal
            os.close(main)
        assert process.wait() == 0
        assert b"of 2 s" in shown
