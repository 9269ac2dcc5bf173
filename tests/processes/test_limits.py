"""Little memory, few handles, a full disk: the right result, or one clear line, and never a hang."""

from __future__ import annotations

import functools
import resource

import pytest

from .place import Place, scene_in

MIB = 1 << 20


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = scene_in(Place(tmp_path_factory.mktemp("l")))
    assert place.run("render", "scene.toml", "-o", "a.ppm")[0] == 0  # compiles
    return place


def limited(kind, value):
    return {"preexec_fn": functools.partial(resource.setrlimit, kind, (value, value))}


def is_right_or_said(place, outcome):
    code, _, errors = outcome
    if code < 0:
        # PoCL aborts the process where it cannot start a thread, and so does its compiler, in C++, without memory.
        aborts = "PTHREAD ERROR", "LLVM ERROR: out of memory", "std::bad_alloc"
        assert any(abort in errors for abort in aborts), errors
        return
    # The C library's loader ends the process where a new thread finds no memory for its data.
    assert code in (0, 1, 3) or (code == 127 and "thread-local data: ABORT" in errors), errors
    assert not any(line.startswith("Traceback") for line in errors.splitlines()), errors
    assert code in (0, 127) or "clbvh: " in errors or "OpenBLAS" in errors, errors
    assert place.leftovers() == []


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("size_mib", [300, 500, 700])
def test_little_memory(place, size_mib, workers):
    words = ("render", "scene.toml", "-o", "b.ppm", "--workers", workers)
    is_right_or_said(place, place.run(*words, **limited(resource.RLIMIT_AS, size_mib * MIB)))


@pytest.mark.parametrize("count", [8, 12])
def test_few_handles(place, count):
    words = ("render", "scene.toml", "-o", "c.ppm", "--workers", 1)
    is_right_or_said(place, place.run(*words, **limited(resource.RLIMIT_NOFILE, count)))


def test_a_disk_that_is_full_names_the_file_and_leaves_the_old_one(place):
    old = place.output / "old.ppm"
    old.write_bytes(b"old")
    words = ("render", "scene.toml", "-o", old, "--width", 1600, "--height", 1000)
    place.run(*words[:2], "-o", "new.ppm", *words[4:])  # compiles
    # Files end at this size; PoCL writes smaller ones whenever it starts.
    code, output, errors = place.run(*words, **limited(resource.RLIMIT_FSIZE, 4 * MIB))
    assert (code, output, errors) == (1, "", f"clbvh: {old}: File too large\n")
    assert old.read_bytes() == b"old"
    assert place.leftovers() == []
