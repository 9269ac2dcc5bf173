"""clbvh where pyopencl is not installed: simulated in processes that do not find it, nor do their children."""

import json
import subprocess
import sys

from ..cli.command import make_environment, refuses, run_process, shadowed_modules

TIMEOUT_S = 300

HIDE = """
from importlib.machinery import PathFinder
find = PathFinder.find_spec
PathFinder.find_spec = lambda name, *rest: None if name == "pyopencl" else find(name, *rest)
"""

USE = """
import importlib, pickle, pkgutil
import numpy as np, trimesh
import clbvh
from tests.unit.viewer.page import Page

for module in pkgutil.walk_packages(clbvh.__path__, "clbvh."):
    importlib.import_module(module.name)
(host,) = clbvh.list_devices()
assert host.is_host and clbvh.choose_device() == host

mesh, ray = clbvh.make_shape("icosphere", triangles=320), ([[0, 0, 5]], [[0, 0, -1]])
tracer = clbvh.Tracer(clbvh.build(mesh, quality="fast"))
for each in tracer, pickle.loads(pickle.dumps(tracer)), clbvh.ShardedTracer("shards"):
    assert 4 <= each.closest_hit(*ray).t[0] < 4.1
assert tracer.closest_hit(*ray, out="device").t.shape == (1,)
assert clbvh.render(mesh, width=40, height=30).rgb.any()

from clbvh.integrations.trimesh import RayMeshIntersector
ball = trimesh.Trimesh(mesh.vertices, mesh.faces)
ball.ray = RayMeshIntersector(ball)
assert ball.contains([[0, 0, 0]])[0]

with clbvh.Renderer(mesh) as renderer, Page(renderer) as page:
    assert page.settle().any()
"""


def test_all_but_devices_of_opencl_works_and_one_sentence_says_what_those_need(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(HIDE)
    environment = shadowed_modules(tmp_path)
    lack = "OpenCL needs pyopencl, which cannot be imported (No module named 'pyopencl'): run `pip install pyopencl`"
    answer = run_process("devices", "--json", **environment)
    report = json.loads(answer.stdout)
    assert ([each["platform"] for each in report["devices"]], report["problems"]) == (["host"], [lack])
    assert answer.stderr == f"clbvh: {lack}\n"
    answer = run_process("doctor", **environment)
    lines = answer.stdout.splitlines()
    assert (answer.returncode, lines[-1]) == (0, "1 of 1 devices work")
    note = lines.index("note    pyopencl cannot be imported: No module named 'pyopencl'")
    assert lines[note + 1].split() == ["$", "pip", "install", "pyopencl"]
    for word in "gpu", "pocl":
        answer = run_process("render", "demo", "-o", tmp_path / "out.ppm", "--device", word, **environment)
        refuses(answer, 3, f"no device matches '{word}': {lack}")

    (tmp_path / "wall.off").write_text("OFF\n3 1 0\n-9 -9 1\n9 -9 1\n0 9 1\n3 0 1 2\n")
    answer = run_process("shard", tmp_path / "wall.off", "-o", tmp_path / "shards", **environment)
    assert answer.returncode == 0, answer.stderr
    process = subprocess.run(
        [sys.executable, "-c", USE],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        cwd=tmp_path,
        env=make_environment(**environment),
        check=False,
    )
    assert process.returncode == 0, process.stderr
