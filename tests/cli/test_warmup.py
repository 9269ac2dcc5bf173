"""`clbvh warmup`: after it, no command and no code of the README compiles anything."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from clbvh.device.select import list_devices

from .command import make_environment, refuses, run_clbvh

ROOT = Path(__file__).parents[2]

# Seconds; everything may have to be compiled, beside other tests.
PATIENCE_S = 1500

SCENE = '[mesh]\nshape = "knot"\ntriangles = 5000\n[image]\nwidth = 64\nheight = 40\n'


def run_spied(folder, tasks):
    """Run commands and code in a process of their own, in a folder; return what machine code they needed."""
    listed = folder / "code.json"
    process = subprocess.run(
        [sys.executable, "-m", "tests.compiled_code", listed],
        input=json.dumps(tasks),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        cwd=folder,
        env=make_environment(PYTHONPATH=str(ROOT), CLBVH_CACHE=str(folder / "cache")),
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return json.loads(listed.read_text()), process.stdout


@pytest.fixture(scope="module")
def warmed(session_of_module, tmp_path_factory):
    """What a warm-up leaves behind, and its report."""
    code, output = run_spied(tmp_path_factory.mktemp("warm"), [["warmup", "--json"]])
    return set(code["versions"]), json.loads(output)


@pytest.fixture(scope="module")
def session_of_module():
    if not list_devices():
        pytest.skip("no OpenCL device")


@pytest.fixture
def folder(tmp_path):
    """A folder with the files that the README names."""
    text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    text += "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    text += "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
    (tmp_path / "bunny.ply").write_text(text)
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "knot.toml").write_text(SCENE)
    return tmp_path


def check(warmed, folder, tasks):
    code, _ = run_spied(folder, tasks)
    assert code["versions"]
    assert set(code["versions"]) - warmed[0] == set()
    assert code["compiled"] == []


def test_a_second_warmup_has_nothing_to_do(warmed, folder):
    code, output = run_spied(folder, [["warmup"], ["warmup", "--json", "--quick"]])
    table, _, report = output.partition("{")
    assert code["compiled"] == []
    assert re.search(r"compiled +nothing: all is there", table)
    assert json.loads("{" + report)["compiled"] == 0


def test_the_report_lists_steps_and_adds_up(warmed):
    report = warmed[1]
    assert report["devices"]
    for key in ("compiled", "loaded", "compile_ms"):
        assert report[key] == pytest.approx(sum(step[key] for step in report["steps"]))
    assert sum(step["total_ms"] for step in report["steps"]) <= report["total_ms"]
    assert {step["where"] for step in report["steps"]} == {"host", *report["devices"]}
    what = " ".join(step["what"] for step in report["steps"])
    for word in ("bvh2", "bvh4", "bvh8", "float32", "fast", "high", "ladder", "validation"):
        assert word in what


def test_no_command_compiles_after_it(warmed, folder):
    scene = "scenes/knot.toml"
    tasks = [
        ["render", "bunny.ply", "-o", "a.ppm", "--hits", "hits.npz", "--validate"],
        ["render", scene, "-o", "a.png", "--cache", "--json"],
        ["render", scene, "-o", "a.png", "--cache", "--json"],
        ["render", scene, "-o", "a.png", "--quality", "high", "--layout", "bvh4"],
        ["render", scene, "-o", "a.png", "--quality", "fast", "--layout", "bvh2", "--workers", "2"],
        ["render", scene, "-o", "a.png", "--builder", "median", "--bins", "12", "--json"],
        ["render", "bunny.ply", "-o", "a.ppm", "--builder", "brute"],
        ["render", scene, "-o", "a.png", "--workers", "2", "--task-threshold", "500"],
        ["stats", "bunny.ply"],
        ["stats", scene, "--rays", "--exact", "--builder", "frontier"],
    ]
    check(warmed, folder, tasks)


def test_no_code_of_the_readme_compiles_after_it(warmed, folder):
    snippets = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(snippets) >= 3
    check(warmed, folder, ["\n".join(snippets).replace("workers=8", "workers=2")])


def test_no_example_compiles_after_it(warmed, folder):
    run = "import runpy, sys; sys.argv = {!r}; runpy.run_path(sys.argv[0], run_name='__main__')"
    examples = sorted((ROOT / "examples").glob("*.py"))
    check(warmed, folder, [run.format([str(path), "bunny.ply"]) for path in examples])


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_no_query_of_the_api_compiles_after_it(warmed, folder, dtype):
    code = f"""
import clbvh, numpy as np
mesh = clbvh.make_shape("knot", triangles=5000)
random = np.random.default_rng(0)
with clbvh.Tracer(mesh) as tracer:
    for shape in ((3,), (20, 30, 3), (70_000, 3)):
        origins, directions = (random.normal(size=shape).astype("{dtype}") for _ in range(2))
        hits = tracer.closest_hit(origins, directions)
        seen = hits[hits.is_hit]
        seen.offset_origins(), seen.offset_origins(towards=seen.normals)
        tracer.hits_by_depth(origins, directions)
        tracer.all_hits(origins, directions, max_hits=3).locations
    tracer.update(mesh.vertices.astype("{dtype}") * 1.1)
    tracer.closest_hit(origins, directions)
"""
    check(warmed, folder, [code])


def test_an_unknown_device_exits_3():
    refuses(run_clbvh("warmup", "--device", "no such card"), 3, "no such card")
