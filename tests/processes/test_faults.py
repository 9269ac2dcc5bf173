"""Whole commands under signals, limits, and folders and streams that cannot be used (Linux): docs/reliability.md."""

import functools
import json
import os
import random
import re
import resource
import signal
import time

import pytest

from ..profiles import is_long
from .place import Place
from .sessions import list_session, wait_until

MIB = 1 << 20

COMMANDS = {
    "render": ("render", "scene.toml", "-o", "a.png", "--hits", "a.npz", "--cache"),
    "workers": ("render", "scene.toml", "-o", "a.png", "--workers", 2),
    "fetch": ("fetch", "--list"),
    "stats": ("stats", "scene.toml"),
    "stats-workers": ("stats", "scene.toml", "--workers", 2, "--rays"),
    "devices": ("devices",),
    "doctor": ("doctor",),
}
# A short run takes the first three: the others differ in nothing that is interrupted.
NAMES = list(COMMANDS) if is_long() else list(COMMANDS)[:3]
# These print line by line; the others print once all is done.
PRINTS_EARLY = ("devices", "doctor", "fetch")
MOMENTS = 200 if is_long() else 2

# LLVM, inside PoCL, removes its files at once when a signal comes, and may miss them before clbvh is heard.
COMPILERS_LAST_WORD = "1 error generated."
SAID = {signal.SIGINT: "clbvh: interrupted", signal.SIGTERM: "clbvh: terminated", signal.SIGHUP: "clbvh: hung up"}

# More samples than are taken before the signal comes, at a moment from the call of `main` when some are taken.
LONG_RENDER = ("render", "scene.toml", "-o", "a.png", "--samples", 10_000_000, "--json")
MOMENT_S = 4.0


@pytest.fixture(scope="module")
def warm_place(tmp_path_factory):
    """A place where the usual commands have been compiled."""
    place = Place(tmp_path_factory.mktemp("f"))
    for words in (
        ("render", "scene.toml", "-o", "warm.png", "--samples", 2),
        ("turntable", "scene.toml", "-o", "warm.gif", "--frames", 2),
    ):
        code, _, errors = place.run(*words)
        assert code == 0, errors
    return place


@pytest.fixture
def place(warm_place):
    """The same with nothing but a scene in its folder; nothing is left in it by the end of a test."""
    for path in warm_place.output.iterdir():
        if path.name != "scene.toml":
            path.unlink()
    yield warm_place
    assert warm_place.leftovers() == []


def said(errors):
    return [line for line in errors.splitlines() if line != COMPILERS_LAST_WORD]


def files(place):
    return {path.name for path in place.output.iterdir()}


def find_problem(place, outcome, name, usual_line_count):
    """Return what is wrong about a command that was interrupted, or that ended just before; empty if nothing is."""
    code, output, errors = outcome
    checks = {
        "exit code": code in (0, 130),
        "message": said(errors) == ([] if code == 0 else [SAID[signal.SIGINT]]),
        "half output": code == 0 or output.count("\n") in (0, usual_line_count) or name in PRINTS_EARLY,
        "leftovers": place.leftovers() == [],
        "files": files(place) <= {"scene.toml", "a.png", "a.npz"},
    }
    failed = [check for check, holds in checks.items() if not holds]
    return f"{', '.join(failed)}: {outcome} {place.leftovers()}" if failed else ""


@pytest.mark.parametrize("name", NAMES)
def test_ctrl_c_at_any_moment_leaves_nothing(place, name):
    words = COMMANDS[name]
    code, output, _ = place.run(*words)
    assert code == 0
    usual_s = min(place.time(*words) for _ in range(2))
    moments, problems, interrupted = random.Random(f"Ctrl-C, {name}"), [], 0
    for _ in range(MOMENTS):
        # Beyond the usual end, too, so that the end itself is tried.
        moment_s = moments.uniform(0, 1.05 * usual_s)
        outcome = place.signal_at(moment_s, signal.SIGINT, *words)
        interrupted += outcome[0] == 130
        if problem := find_problem(place, outcome, name, output.count("\n")):
            problems.append(f"after {moment_s:.3f} of {usual_s:.3f} s: {problem}")
    assert problems == []
    # The few moments of a short run may all be late, where the machine was busy when the time was taken.
    assert interrupted > 0 or not is_long()


def test_an_ignored_ctrl_c_stays_ignored(place):
    # A job in the background, as shells start it.
    process = place.start(*COMMANDS["stats"], ignore_interrupts=True)
    os.killpg(process.pid, signal.SIGINT)
    code, _, errors = place.finish(process)
    assert (code, errors) == (0, "")


def test_keep_writes_the_samples_so_far(place):
    code, output, errors = place.signal_at(MOMENT_S, signal.SIGINT, *LONG_RENDER, "--keep")
    assert (code, errors) == (0, "")
    assert 1 <= json.loads(output)["samples"] < 10_000_000
    assert files(place) == {"a.png", "scene.toml"}


@pytest.mark.parametrize(
    ("number", "more"),
    [(signal.SIGTERM, ("--workers", 2)), (signal.SIGHUP, ("--keep",))],
    ids=["terminate workers", "hang up and keep"],
)
def test_another_signal_ends_a_command_and_nothing_is_written(place, number, more):
    code, output, errors = place.signal_at(MOMENT_S, number, *LONG_RENDER, *more)
    assert (code, output, said(errors)) == (128 + number, "", [SAID[number]])
    assert files(place) == {"scene.toml"}


def test_a_second_ctrl_c_ends_the_command(place):
    # A launch of this many pixels takes longer than the pause between the two signals.
    process = place.start(*LONG_RENDER, "--keep", "--width", 8000, "--height", 8000)
    time.sleep(MOMENT_S)
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    code, output, errors = place.finish(process)
    assert (code, output, said(errors)) == (130, "", [SAID[signal.SIGINT]])
    assert files(place) == {"scene.toml"}


def test_ctrl_c_between_frames_leaves_no_half_animation_and_no_ffmpeg(place):
    process = place.start("turntable", "scene.toml", "-o", "a.mp4", "--frames", 2000)
    # An unfinished file is there once frames are drawn.
    assert wait_until(lambda: len(files(place)) > 1, 60)
    time.sleep(0.3)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    code, output, errors = place.finish(process)
    assert (code, output, said(errors)) == (130, "", [SAID[signal.SIGINT]])
    assert wait_until(lambda: not list_session(process.pid), 10), "processes are left"
    assert files(place) == {"scene.toml"}


def test_a_killed_command_leaves_no_process_and_stops_no_later_run(place):
    words, moments = COMMANDS["render"][:4], random.Random("SIGKILL of a command")
    usual_s = place.time(*words)
    for _ in range(40 if is_long() else 1):
        process = place.start(*words)
        time.sleep(moments.uniform(0, usual_s))
        process.kill()
        process.communicate()
        # Its linker may still run.
        assert wait_until(lambda leader=process.pid: not list_session(leader), 20)
        code, _, errors = place.run(*words)
        assert (code, errors) == (0, "")


def limited(kind, value):
    return {"preexec_fn": functools.partial(resource.setrlimit, kind, (value, value))}


@pytest.mark.parametrize(
    ("limits", "workers"),
    [*((limited(resource.RLIMIT_AS, size * MIB), 1 + (size == 500)) for size in (300, 500, 700)),
     *((limited(resource.RLIMIT_NOFILE, count), 1) for count in (8, 12))],
    ids=["300 MiB", "500 MiB", "700 MiB", "8 handles", "12 handles"],
)  # fmt: skip
def test_little_memory_and_few_handles_give_the_result_or_one_line(place, limits, workers):
    words, traces = ("render", "scene.toml", "-o", "b.ppm", "--workers", workers), {"PYTHONFAULTHANDLER": "1"}
    code, _, errors = place.run(*words, environment=traces, **limits)
    if code < 0:
        # PoCL aborts the process where it cannot start a thread, and so does its compiler, in C++, without memory. A
        # thread of its own, which never runs Python, may meet a null pointer.
        in_driver = "Segmentation fault\n\nThread 0x[0-9a-f]+ \\(most recent call first\\):\n  <no Python frame>"
        aborts = "PTHREAD ERROR", "LLVM ERROR: out of memory", "std::bad_alloc", in_driver
        assert any(re.search(abort, errors) for abort in aborts), errors
        return
    # The C library's loader ends the process where a new thread finds no memory for its data.
    assert code in (0, 1, 3) or (code == 127 and "thread-local data: ABORT" in errors), errors
    assert not any(line.startswith("Traceback") for line in errors.splitlines()), errors
    assert code in (0, 127) or "clbvh: " in errors or "OpenBLAS" in errors, errors


def test_a_full_disk_names_the_file_and_leaves_the_old_one(place):
    old = place.output / "old.ppm"
    old.write_bytes(b"old")
    # Files end at this size; PoCL writes smaller ones whenever it starts.
    limit = limited(resource.RLIMIT_FSIZE, 4 * MIB)
    code, output, errors = place.run("render", "scene.toml", "-o", old, "--width", 1600, "--height", 1000, **limit)
    assert (code, output, errors) == (1, "", f"clbvh: {old}: File too large\n")
    assert old.read_bytes() == b"old"


def test_a_full_disk_behind_stdout_is_one_line(place):
    with open("/dev/full", "wb") as full:  # noqa: PTH123
        code, _, errors = place.finish(place.start("stats", "scene.toml", stdout=full))
    assert code == 1
    assert errors.startswith("clbvh: ")
    assert errors.endswith("No space left on device\n")
    assert errors.count("\n") == 1


@pytest.mark.parametrize("words", [("stats", "scene.toml"), ("devices",), ("--help",)], ids=" ".join)
def test_a_reader_that_has_gone_is_told_nothing(place, words):
    read_end, write_end = os.pipe()
    os.close(read_end)
    process = place.start(*words, stdout=write_end)
    os.close(write_end)
    code, _, errors = place.finish(process)
    assert (code, errors) == (1, "")


@pytest.mark.parametrize("name", ["kügel-球.toml", os.fsdecode(b"not-\xff-text.toml")], ids=["letters", "bytes"])
def test_an_ascii_terminal_shows_any_name(place, name):
    scene = place.output / name
    scene.write_text((place.output / "scene.toml").read_text())
    ascii_only = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    code, output, errors = place.run("stats", scene, environment=ascii_only)
    assert (code, errors) == (0, "")
    assert output.isascii()
    code, output, errors = place.run("stats", place.output / f"gone-{name}", environment=ascii_only)
    assert (code, output) == (2, "")
    assert errors.startswith("clbvh: ")


def test_a_picture_needs_no_home_and_that_is_said_once(place):
    words = ("render", "scene.toml", "-o", "a.ppm", "--workers", 2, "--cache")
    assert place.run(*words)[0] == 0
    picture = (place.output / "a.ppm").read_bytes()
    # Machine code alone is kept elsewhere, to save time.
    (place.folder / "file").touch()
    homeless = dict.fromkeys(("XDG_CACHE_HOME", "CLBVH_CACHE", "POCL_CACHE_DIR"), "")
    code, output, errors = place.run(*words, environment={"HOME": str(place.folder / "file" / "home"), **homeless})
    assert code == 0, errors
    assert "triangles" in output
    (line,) = errors.splitlines()
    assert line.startswith("clbvh: nothing can be kept in the cache ")
    assert (place.output / "a.ppm").read_bytes() == picture


def test_a_folder_for_temporary_files_that_is_not_there_is_no_matter(place):
    code, _, errors = place.run(*COMMANDS["workers"], environment={"TMPDIR": str(place.folder / "nowhere")})
    assert (code, errors) == (0, "")


@pytest.mark.parametrize("round_", range(20 if is_long() else 1))
def test_two_commands_share_empty_caches(tmp_path, round_):
    place, words = Place(tmp_path), ("render", "scene.toml", "--cache", "--width", 64)
    environment = {"POCL_CACHE_DIR": str(tmp_path / "pocl"), "XDG_CACHE_HOME": str(tmp_path / "xdg")}
    both = [place.start(*words, "-o", name, environment=environment) for name in ("a.ppm", "b.ppm")]
    for process in both:
        code, _, errors = place.finish(process)
        assert (code, errors) == (0, "")
    assert place.run(*words, "-o", "c.ppm", environment=environment)[0] == 0
    assert len({(place.output / name).read_bytes() for name in ("a.ppm", "b.ppm", "c.ppm")}) == 1
    assert len(list((place.cache / "trees").iterdir())) == 1
    assert place.leftovers() == []
