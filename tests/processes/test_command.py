"""The command as a process: exit codes, first runs, what it imports, and how long `--help` takes."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from importlib.metadata import version

import pytest

from clbvh.cli.app import VERBS

from ..cli.command import TIMEOUT_S, make_environment, run_process

OFF = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"
MAIN = "from clbvh.cli import main; main()"
SIZE = ("--width", 64, "--height", 48, "--up", "0,1,0")

# The promise for a help is 0.3 s on an idle machine. A busy one takes longer for any program, so the test compares it,
# in processor time, with the help of a program that has two commands and nothing else.
SMALLEST_PROGRAM = """
import cyclopts
app = cyclopts.App(name="two")
@app.command
def first(source: str, *, output: str = "a", width: int = 3):
    "Do the first."
@app.command
def second(source: str):
    "Do the second."
app()
"""
HELP_RATIO = 1.5

# Libraries that take long to import; no option and no help needs one.
HEAVY = {"numpy", "pyopencl", "trimesh", "imageio", "matplotlib", "pooch", "requests", "multiprocessing"}

# Libraries for files that are not read here, for figures, for the network and for tests; and builders, readers and
# references that nobody asked for.
OTHERS = {
    "asyncio", "imageio", "matplotlib", "numpy.f2py", "numpy.testing", "PIL", "pooch", "requests", "trimesh",
    "unittest", "clbvh.builders.device", "clbvh.builders.ladder.steps", "clbvh.builders.reinsertion",
    "clbvh.geometry.loading.gltf", "clbvh.geometry.loading.obj", "clbvh.trace.check.reference",
}  # fmt: skip

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


@pytest.fixture
def mesh(tmp_path):
    """A file with a small mesh."""
    path = tmp_path / "mesh.off"
    path.write_text(OFF)
    return path


@pytest.fixture
def cold(tmp_path):
    """The environment of a machine on which nothing has been compiled."""
    folders = {name: str(tmp_path / name) for name in ("CLBVH_CACHE", "POCL_CACHE_DIR")}
    return {**folders, "XDG_CACHE_HOME": str(tmp_path)}


def test_python_m_is_the_command():
    module = subprocess.run([sys.executable, "-m", "clbvh", "--version"], capture_output=True, text=True, check=True)
    assert module.stdout == run_process("--version").stdout == f"clbvh {version('clbvh')}\n"


def test_exit_codes(mesh, tmp_path):
    picture = ("render", mesh, "-o", tmp_path / "a.ppm", *SIZE)
    gone = ("render", tmp_path / "gone.ply", "-o", tmp_path / "a.ppm")
    codes = {
        picture: 0,
        ("fetch", "bunny", "--base-url", "http://127.0.0.1:9"): 1,
        gone: 2,
        (*picture, "--device", "no such card"): 3,
    }
    for words, code in codes.items():
        answer = run_process(*words, CLBVH_CACHE=str(tmp_path), CLBVH_MESHES="")
        assert answer.returncode == code, words
        assert (answer.stderr == "") if code == 0 else answer.stderr.startswith("clbvh: ")
    assert (tmp_path / "a.ppm").read_bytes().startswith(b"P6")
    debug = run_process(*gone, "--debug")
    assert debug.returncode == 2
    assert debug.stderr.startswith("Traceback")
    assert debug.stderr.splitlines()[-1] == run_process(*gone).stderr.strip()


@pytest.mark.usefixtures("session")
def test_a_first_run_compiles_nothing(mesh, tmp_path, cold):
    begin_s = time.perf_counter()
    answer = run_process("render", mesh, "-o", tmp_path / "a.ppm", *SIZE, "--json", **cold)
    waited_ms = (time.perf_counter() - begin_s) * 1e3
    assert (answer.returncode, answer.stderr, answer.compiled) == (0, "", False)
    times = json.loads(answer.stdout)["timings_ms"]
    assert sum(times[name] for name in times if name != "total") == pytest.approx(times["total"])
    # The user waits for nothing else, but for the end of Python.
    assert 0.6 * waited_ms < times["total"] < waited_ms + 20


def processor_time_of(code, *words):
    """Run a program and return the seconds of processor time that it took, and its output."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", code, *words, "--help"]
    output = subprocess.check_output(command, env=make_environment(COLUMNS="100"), text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, output


@pytest.mark.parametrize(
    ("words", "small_words", "said"),
    [((), (), VERBS), (("render",), ("first",), ("--output", "--samples", "--leaf-size"))],
    ids=["program", "verb"],
)
def test_help_is_quick_and_complete(words, small_words, said):
    least_s = least_of_smallest_s = float("inf")
    for _ in range(20):
        taken_s, output = processor_time_of(MAIN, *words)
        least_s = min(least_s, taken_s)
        least_of_smallest_s = min(least_of_smallest_s, processor_time_of(SMALLEST_PROGRAM, *small_words)[0])
        if least_s < HELP_RATIO * least_of_smallest_s:
            break
    assert least_s < HELP_RATIO * least_of_smallest_s
    assert [word for word in said if word not in output] == []


def list_modules(folder, program, *words):
    """Return the modules that a program has imported when it ends."""
    # Every import anywhere in the program is seen. The list goes to a file: a command prints its own report.
    spy = "\nimport json, sys\nwith open('modules.json', 'w') as file:\n    json.dump(sorted(sys.modules), file)\n"
    process = subprocess.run(
        [sys.executable, "-c", program + spy, *words],
        capture_output=True, text=True, timeout=TIMEOUT_S, cwd=folder, env=make_environment(), check=False,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return set(json.loads((folder / "modules.json").read_text()))


def test_the_package_and_its_help_import_no_library(tmp_path):
    modules = list_modules(tmp_path, "import clbvh")
    assert "clbvh" in modules
    assert modules & ({"cyclopts", "rich"} | HEAVY | OTHERS) == set()
    for words in (("--help",), ("devices", "--help"), ("doctor", "--help"), ("render", "--help")):
        assert list_modules(tmp_path, PICTURE, *words) & HEAVY == set(), words


@pytest.mark.usefixtures("session")
def test_a_hit_needs_no_picture_and_a_picture_no_check(mesh):
    modules = list_modules(mesh.parent, HIT)
    assert "clbvh.trace.tracer" in modules
    assert modules & ({"clbvh.rendering", "clbvh.cli", "cyclopts", "rich"} | OTHERS) == set()
    modules = list_modules(mesh.parent, PICTURE, "render", "mesh.off", "-o", "a.ppm", "--width", "32")
    assert "clbvh.rendering.renderer" in modules
    unwanted = {"clbvh.rendering.check_pixels", "clbvh.rendering.heat_map"}
    assert modules & (unwanted | OTHERS) == set()
