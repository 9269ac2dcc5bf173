"""What a new process imports: each of these costs a short program time that it has no use for."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from ..cli.command import TIMEOUT_S, make_environment

# Modules that numba imports before it compiles. Loading machine code needs none of them.
TO_COMPILE = (
    "numba.np.arraymath",
    "numba.np.arrayobj",
    "numba.core.inline_closurecall",
    "numba.typed.typedlist",
    "scipy.linalg",
)

# Libraries for files that are not read here, for figures, for the network and for tests.
OTHER_LIBRARIES = (
    "asyncio", "imageio", "matplotlib", "numpy.f2py", "numpy.testing", "PIL", "pooch", "requests", "trimesh",
    "unittest",
)  # fmt: skip

# Builders, readers and references that nobody asked for.
OTHER_PARTS = (
    "clbvh.builders.hlbvh", "clbvh.builders.ladder.steps", "clbvh.builders.reinsertion", "clbvh.geometry.loading.gltf",
    "clbvh.geometry.loading.obj", "clbvh.trace.check.reference",
)  # fmt: skip

HIT = """
import clbvh
with clbvh.Tracer(clbvh.make_shape("icosphere", triangles=320)) as tracer:
    assert tracer.closest_hit([0, 0, 5], [0, 0, -1]).prim_id >= 0
"""

PICTURE = """
from clbvh.cli import main
try:
    main()
except SystemExit as ended:
    assert not ended.code
"""

# Every import anywhere in the program is seen. The list goes to a file: a command prints its own report.
SPY = """
import json, sys
{program}
with open("modules.json", "w") as file:
    json.dump(sorted(sys.modules), file)
"""

OFF = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"


def list_modules(folder, program, words=(), runs=1):
    """Return the modules that a program has imported when it ends, the last time that it runs."""
    for _ in range(runs):
        process = subprocess.run(
            [sys.executable, "-c", SPY.format(program=program), *words],
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            cwd=folder,
            env=make_environment(),
            check=False,
        )
        assert process.returncode == 0, process.stderr
    return set(json.loads((folder / "modules.json").read_text()))


def test_the_package_alone_imports_no_library(tmp_path):
    modules = list_modules(tmp_path, "import clbvh")
    assert "clbvh" in modules
    assert modules & {"numpy", "numba", "pyopencl", "cyclopts", "rich", "multiprocessing", *OTHER_LIBRARIES} == set()


# The second run loads what the first one may have to compile.
@pytest.mark.usefixtures("session")
def test_a_first_hit_needs_no_picture_and_no_compiler(tmp_path):
    modules = list_modules(tmp_path, HIT, runs=2)
    assert "clbvh.trace.tracer" in modules
    unwanted = {"clbvh.rendering", "clbvh.cli", "cyclopts", "rich", *TO_COMPILE, *OTHER_LIBRARIES, *OTHER_PARTS}
    assert modules & unwanted == set()


@pytest.mark.usefixtures("session")
def test_a_picture_of_a_mesh_needs_no_tracer_and_no_compiler(tmp_path):
    (tmp_path / "mesh.off").write_text(OFF)
    modules = list_modules(tmp_path, PICTURE, ("render", "mesh.off", "-o", "a.ppm", "--width", "32"), runs=2)
    assert "clbvh.rendering.renderer" in modules
    unwanted = {"clbvh.trace.tracer", "clbvh.rendering.check_pixels", "clbvh.rendering.heat_map"}
    assert modules & (unwanted | {*TO_COMPILE, *OTHER_LIBRARIES, *OTHER_PARTS}) == set()
