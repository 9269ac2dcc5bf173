"""`clbvh warmup`: after it, no command, no page's code and no example compiles anything.

The functions that are compiled here are those of the suite, in one folder: a warm-up loads what others have compiled,
and leaves the rest to them. So a test compares lists of versions, not times.
"""

from __future__ import annotations

import doctest
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

from clbvh.cli.warmup import _print_report
from clbvh.device.select import list_devices
from clbvh.structs import SHADINGS
from clbvh.warmup.warm_up import WarmStep

from ..docs.snippets import PAGES, find_snippets, list_commands
from ..docs.test_pages import MESHES, NOT_RUN, find_scene_name, replace_placeholders
from .command import make_environment, refuses, run_clbvh

ROOT = Path(__file__).parents[2]

# Seconds; everything may have to be compiled, beside other tests.
PATIENCE_S = 1500

# The examples and their arguments: no larger than needed, and large enough for batches that are sorted.
EXAMPLES = {
    "ambient_occlusion": ["bunny.ply", "--rays", "4"],
    "camera_images": ["--width", "160"],
    "depth_map": ["bunny.ply"],
    "distance_grid": ["bunny.ply", "--cells", "48"],
    "inside_test": ["bunny.ply"],
    "lidar_scan": ["bunny.ply", "--steps", "100"],
    "sky_view": ["bunny.ply", "--width", "60", "--rays", "32"],
    "turntable": ["bunny.ply", "--frames", "2", "--sheet", "sheet.png"],
}

# A command among the Python blocks of a page.
RUN = """
from clbvh.cli.app import run
try:
    run({!r})
except SystemExit as ended:
    assert not ended.code
"""

# A scene file of a page.
WRITE = """
from pathlib import Path
Path({!r}).write_text({!r})
"""

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
    """A folder with the files that the pages name."""
    for name in MESHES:
        trimesh.creation.icosphere(2, 0.1).apply_translation((0, 0.1, 0)).export(tmp_path / name, encoding="ascii")
    (tmp_path / "out").mkdir()
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    (tmp_path / "small.toml").write_text(SCENE)
    return tmp_path


# Kernels of pictures that are compiled when they are first asked for, by their names or options: those of paths, cuts,
# lines, holes and bent normals.
ASKED_FOR = (
    f"-DSHADING={SHADINGS['path']}'",
    "join_cells (",
    "-DHAS_CUT=1'",
    "-DHAS_WIREFRAME=1'",
    "-DHAS_CUTOUTS=1'",
    "-DHAS_NORMAL_MAPS=1'",
)


def check(warmed, folder, tasks):
    code, _ = run_spied(folder, tasks)
    assert code["versions"]
    missing = set(code["versions"]) - warmed[0]
    assert {version for version in missing if not any(option in version for option in ASKED_FOR)} == set()
    assert code["compiled"] == []


def test_a_second_warmup_has_nothing_to_do(warmed, folder):
    code, output = run_spied(folder, [["warmup", "--json"]])
    assert code["compiled"] == []
    # Kernels are told from compiled ones by the time, which on a busy machine is no proof.
    assert sum(step["compiled"] for step in json.loads(output)["steps"] if step["where"] == "host") == 0


@pytest.mark.parametrize(("compiled", "said"), [(0, "nothing: all is there"), (1200, "1,200 functions and kernels in")])
def test_the_table_says_what_was_compiled(compiled, said, capsys):
    report = {"compiled": compiled, "compile_ms": 2500.0, "total_ms": 4000.0}
    _print_report(report, [WarmStep("host", "layouts", compiled, 7, 2500.0, 4000.0)])
    assert re.search(rf"compiled +{said}", capsys.readouterr().out)


def test_a_quick_warmup_is_part_of_the_whole_one(warmed, folder):
    check(warmed, folder, [["warmup", "--quick"]])


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
    scene = "small.toml"
    tasks = [
        ["render", "bunny.ply", "-o", "a.ppm", "--hits", "hits.npz", "--validate"],
        ["render", scene, "-o", "a.png", "--cache", "--json"],
        ["render", scene, "-o", "a.png", "--cache", "--json"],
        ["render", scene, "-o", "a.png", "--quality", "high", "--layout", "bvh4"],
        ["render", scene, "-o", "a.png", "--quality", "fast", "--layout", "bvh2", "--workers", "2"],
        ["render", scene, "-o", "a.png", "--builder", "median", "--bins", "12", "--json"],
        ["render", "bunny.ply", "-o", "a.ppm", "--builder", "brute"],
        ["render", scene, "-o", "a.png", "--workers", "2", "--task-threshold", "500"],
        ["render", scene, "-o", "a.png", "--heatmap", "triangles"],
        ["stats", "bunny.ply"],
        ["stats", scene, "--rays", "--exact", "--builder", "frontier"],
    ]
    check(warmed, folder, tasks)


def make_program(page):
    """Return what a page runs as one Python program, its commands included; without Python blocks, nothing."""
    parts = []
    snippets = [snippet for snippet in find_snippets(page) if not snippet.reason]
    if not any(snippet.language == "python" for snippet in snippets):
        return ""
    for snippet in snippets:
        if snippet.language == "python":
            examples = doctest.DocTestParser().get_examples(snippet.text)
            parts.append("".join(example.source for example in examples) or snippet.text)
        if snippet.language == "toml":
            parts.append(WRITE.format(find_scene_name(snippet), snippet.text))
        for command in list_commands(snippet):
            words = replace_placeholders(command) if command.startswith("clbvh ") else []
            if words and " ".join(words[:2]) not in NOT_RUN:
                parts.append(RUN.format(words[1:]))
    return "\n".join(parts).replace("workers=8", "workers=2")


def test_no_code_of_the_pages_compiles_after_it(warmed, folder):
    programs = {str(page.relative_to(ROOT)): make_program(page) for page in PAGES}
    assert all(programs[name] for name in ("README.md", "docs/tracing.md", "docs/cameras.md", "docs/trimesh.md"))
    check(warmed, folder, [program for program in programs.values() if program])


def test_meshes_that_move_compile_nothing_after_it(warmed, folder):
    code = (
        "import clbvh\n"
        "mesh = clbvh.make_shape('icosphere', triangles=1000)\n"
        "for layout in ('bvh2', 'bvh4', 'bvh8'):\n"
        "    with clbvh.Tracer(mesh, layout=layout) as tracer:\n"
        "        tracer.update(mesh.vertices * 2)\n"
        "        tracer.closest_hit([0, 0, 5], [0, 0, -1]).offset_origins()\n"
    )
    check(warmed, folder, [code])


def test_no_example_compiles_after_it(warmed, folder):
    run = "import runpy, sys; sys.argv = {!r}; runpy.run_path(sys.argv[0], run_name='__main__')"
    examples = sorted((ROOT / "examples").glob("*.py"))
    assert {path.stem for path in examples} == {*EXAMPLES}
    check(warmed, folder, [run.format([str(path), *EXAMPLES[path.stem]]) for path in examples])


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
        tracer.all_hits(origins, directions, with_locations=True)
        tracer.all_hits(origins, directions, max_hits=3).locations
    tracer.update(mesh.vertices.astype("{dtype}") * 1.1)
    tracer.closest_hit(origins, directions)
"""
    check(warmed, folder, [code])


def test_an_unknown_device_exits_3():
    refuses(run_clbvh("warmup", "--device", "no such card"), 3, "no such card")
