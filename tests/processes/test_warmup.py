"""`clbvh warmup`: after it, the usual commands, queries and examples compile no function.

The functions that are compiled here are those of the suite, in one folder: a warm-up loads what others have compiled,
and leaves the rest to them. So a test compares lists of versions, not times.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

from ..cli.command import make_environment

ROOT = Path(__file__).parents[2]

# Functions that only some input needs.
RARE = 3

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
    "robot_arm": ["--steps", "3", "--width", "96"],
    "sky_view": ["bunny.ply", "--width", "60", "--rays", "32"],
    "turntable": ["bunny.ply", "--frames", "2", "--sheet", "sheet.png"],
}
RUN_EXAMPLE = "import runpy, sys; sys.argv = {!r}; runpy.run_path(sys.argv[0], run_name='__main__')"

SCENE = '[[object]]\nshape = "knot"\ntriangles = 5000\n[view]\nwidth = 64\nheight = 40\n'

QUERIES = """
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
    tracer.closest_hit(origins, directions).offset_origins()
"""

# Words of commands, and Python code.
TASKS = {
    "commands": [
        ["render", "bunny.ply", "-o", "a.ppm", "--hits", "hits.npz"],
        ["render", "small.toml", "-o", "a.png", "--cache", "--json"],
        ["render", "small.toml", "-o", "a.png", "--cache", "--json"],
        ["render", "small.toml", "-o", "a.png", "--quality", "high", "--shading", "path", "--samples", "1"],
        ["render", "small.toml", "-o", "a.png", "--quality", "fast", "--workers", "2"],
        ["stats", "bunny.ply"],
    ],
    "examples": [RUN_EXAMPLE.format([f"{ROOT}/examples/{name}.py", *words]) for name, words in EXAMPLES.items()],
    **{f"queries of {dtype}": [QUERIES.format(dtype=dtype)] for dtype in ("float32", "float64")},
}


def run_spied(folder, tasks):
    """Run commands and code in a process of their own, in a folder; return what machine code they needed."""
    listed = folder / "code.json"
    process = subprocess.run(
        [sys.executable, "-m", "tests.processes.compiled_code", listed],
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
def warmed(_opened_device, tmp_path_factory):
    """What a warm-up leaves behind, and its report."""
    code, output = run_spied(tmp_path_factory.mktemp("warm"), [["warmup", "--json"]])
    return set(code["versions"]), json.loads(output)


def test_a_second_warmup_has_nothing_to_do(warmed, tmp_path):
    code, _ = run_spied(tmp_path, [["warmup", "--json"]])
    assert code["compiled"] == []


@pytest.mark.parametrize("kind", TASKS)
def test_the_usual_work_compiles_nothing_after_it(warmed, tmp_path, kind):
    assert {path.stem for path in (ROOT / "examples").glob("*.py")} == {*EXAMPLES}
    trimesh.creation.icosphere(2, 0.1).apply_translation((0, 0.1, 0)).export(tmp_path / "bunny.ply", encoding="ascii")
    (tmp_path / "small.toml").write_text(SCENE)
    (tmp_path / "out").mkdir()
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    code, _ = run_spied(tmp_path, TASKS[kind])
    assert code["versions"]
    assert len(set(code["versions"]) - warmed[0]) <= RARE
