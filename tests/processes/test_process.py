"""The command as a process: its two names, its exit codes, Ctrl-C, and how long `--help` takes."""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
from importlib.metadata import version

import pytest

from clbvh import make_shape
from clbvh.cli.app import VERBS

from ..cli.command import TIMEOUT_S, make_environment, refuses, run_clbvh, run_process

# Python leaves Ctrl-C alone where the shell that started the tests ignores it, as it does for a job in the background.
_INTERRUPTIBLE = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"

# The promise for a help is 0.3 s on an idle machine. A busy one takes longer for any program, so the test compares it,
# in processor time, with the help of a program that has two commands and nothing else.
_SMALLEST_PROGRAM = """
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
_HELP_RATIO = 1.5
_MOST_RUNS = 20

# Libraries that take long to import; no option and no help needs one.
_HEAVY = ("numpy", "numba", "pyopencl", "trimesh", "imageio", "matplotlib", "pooch", "requests", "multiprocessing")


@pytest.fixture
def mesh(tmp_path):
    """A file with a small mesh."""
    shape = make_shape("icosphere", triangles=20)
    lines = ["OFF", f"{len(shape.vertices)} {shape.face_count} 0"]
    lines += [" ".join(map(str, vertex)) for vertex in shape.vertices]
    lines += ["3 " + " ".join(map(str, face)) for face in shape.faces]
    path = tmp_path / "sphere.off"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_python_m_is_the_command():
    module = subprocess.run([sys.executable, "-m", "clbvh", "--version"], capture_output=True, text=True, check=True)
    assert module.stdout == run_process("--version").stdout == f"clbvh {version('clbvh')}\n"


def test_a_picture_is_exit_code_0(mesh, tmp_path):
    answer = run_process("render", mesh, "-o", tmp_path / "a.ppm", "--width", 40, "--height", 30, "--up", "0,1,0")
    assert (answer.returncode, answer.stderr) == (0, "")
    assert "20 triangles" in answer.stdout
    assert (tmp_path / "a.ppm").read_bytes().startswith(b"P6")


def test_a_run_that_fails_is_exit_code_1(tmp_path):
    answer = run_process(
        "fetch", "bunny", "--base-url", "http://127.0.0.1:9", CLBVH_CACHE=str(tmp_path), CLBVH_MESHES=""
    )
    assert answer.returncode == 1
    assert answer.stderr.startswith("clbvh: ")


def test_a_bad_file_is_exit_code_2_and_debug_shows_the_traceback(tmp_path):
    plain = run_process("render", tmp_path / "gone.ply", "-o", tmp_path / "a.ppm")
    debug = run_process("render", tmp_path / "gone.ply", "-o", tmp_path / "a.ppm", "--debug")
    assert plain.returncode == debug.returncode == 2
    assert debug.stderr.startswith("Traceback")
    assert debug.stderr.splitlines()[-1] == plain.stderr.strip()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("rendr", "a.ply"), 'unknown command "rendr". Did you mean "render"? Available commands: render, '),
        (("render", "a.ply", "-o", "a.png", "--widht", "3"), "unknown option: --widht. Did you mean --width?"),
        (("render", "a.ply", "-o", "a.png", "--width", "3.5"), "value for --width: '3.5' is not a whole number"),
        (("stats", "a.ply", "--workers", "two"), "value for --workers: 'two' is not a whole number"),
        (("turntable", "a.ply", "-o", "a.gif", "--frames", "1.5"), "--frames"),
        (("render", "a.ply", "-o", "a.png", "--fov", "wide"), "--fov"),
        (("render", "a.ply", "-o", "a.png", "--width"), "--width requires an argument"),
        (("render", "a.ply"), "--output requires an argument"),
        (("render", "-o", "a.png"), "MESH|SCENE requires an argument"),
        (("devices", "cpu"), "unexpected argument 'cpu'"),
        (("stats", "a.ply", "b.ply"), "unexpected argument 'b.ply'"),
        (("--nonsense",), "--nonsense"),
    ],
)
def test_words_that_cannot_be_parsed_are_one_line(words, said):
    refuses(run_clbvh(*words), 2, said)


def test_no_words_are_wrong_usage_and_get_the_help():
    answer = run_clbvh()
    assert (answer.returncode, answer.stderr) == (2, "")
    assert answer.stdout == run_clbvh("--help").stdout == run_clbvh("-h").stdout


def test_of_an_option_that_is_given_twice_the_last_counts(mesh, tmp_path):
    words = ("render", mesh, "-o", tmp_path / "a.ppm", "--height", 9, "--width", 40, "--width", 16)
    assert run_clbvh(*words).returncode == 0
    assert (tmp_path / "a.ppm").read_bytes().startswith(b"P6\n16 9\n")


def test_options_may_stand_between_sources(mesh, tmp_path):
    answer = run_clbvh("render", mesh, "-o", tmp_path / "a.ppm", "--width", 16, mesh, "--height", 9, "--json")
    assert json.loads(answer.stdout)["instances"] == 2


def test_an_unknown_device_is_exit_code_3(mesh, tmp_path):
    answer = run_process("render", mesh, "-o", tmp_path / "a.ppm", "--device", "no such card")
    assert answer.returncode == 3


def test_ctrl_c_is_exit_code_130_without_a_traceback(tmp_path):
    cache = tmp_path / "cache"
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"http://127.0.0.1:{server.getsockname()[1]}"
        words = ["fetch", "bunny", "--base-url", url]
        process = subprocess.Popen(
            [sys.executable, "-c", f"{_INTERRUPTIBLE}from clbvh.cli import main; main()", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=make_environment(CLBVH_CACHE=str(cache), CLBVH_MESHES="", NO_PROXY="127.0.0.1"),
            text=True,
        )
        server.settimeout(TIMEOUT_S)
        connection, _ = server.accept()
        with connection:
            process.send_signal(signal.SIGINT)
            output, errors = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, output, errors) == (130, "", "clbvh: interrupted\n")
    assert list(cache.iterdir()) == []


def processor_time_of(command):
    """Run a command and return the seconds of processor time that it took, and its output."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    output = subprocess.check_output(command, env=os.environ | {"COLUMNS": "100"}, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, output


@pytest.mark.parametrize(("words", "small_words"), [((), ()), (("render",), ("first",))])
def test_help_is_quick_and_complete(words, small_words):
    least_s = least_of_smallest_s = float("inf")
    for _ in range(_MOST_RUNS):
        of_smallest_s, _output = processor_time_of([sys.executable, "-c", _SMALLEST_PROGRAM, *small_words, "--help"])
        command = [sys.executable, "-c", "from clbvh.cli import main; main()", *words, "--help"]
        taken_s, output = processor_time_of(command)
        least_s = min(least_s, taken_s)
        least_of_smallest_s = min(least_of_smallest_s, of_smallest_s)
        if least_s < _HELP_RATIO * least_of_smallest_s:
            break
    assert least_s < _HELP_RATIO * least_of_smallest_s
    for expected in ("--output", "--samples", "--leaf-size") if words else VERBS:
        assert expected in output


@pytest.mark.parametrize("words", [("--help",), ("devices", "--help"), ("doctor", "--help"), ("render", "--help")])
def test_help_imports_nothing_heavy(words):
    code = (
        "import sys\nfrom clbvh.cli import main\n"
        f"try: main()\nfinally: print('heavy:', [name for name in {_HEAVY} if name in sys.modules], file=sys.stderr)"
    )
    process = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    assert process.stderr == "heavy: []\n"
    assert process.stdout.startswith("Usage: clbvh ")
