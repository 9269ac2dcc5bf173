"""Standard streams that are full, gone, or that can show ASCII only."""

from __future__ import annotations

import os

import pytest

from .place import Place, scene_in


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return scene_in(Place(tmp_path_factory.mktemp("s")))


@pytest.mark.parametrize("words", [("stats", "scene.toml"), ("devices",), ("--help",)], ids=" ".join)
def test_a_reader_that_has_gone_is_told_nothing(place, words):
    read_end, write_end = os.pipe()
    os.close(read_end)
    process = place.start(*words, stdout=write_end)
    os.close(write_end)
    code, _, errors = place.finish(process)
    assert (code, errors) == (1, "")


def test_a_full_disk_behind_stdout_is_one_line(place):
    with open("/dev/full", "wb") as full:  # noqa: PTH123
        code, _, errors = place.finish(place.start("stats", "scene.toml", stdout=full))
    assert code == 1
    assert errors.startswith("clbvh: ")
    assert errors.endswith("No space left on device\n")
    assert errors.count("\n") == 1


@pytest.mark.parametrize("name", ["kügel-球.toml", os.fsdecode(b"not-\xff-text.toml")], ids=["letters", "bytes"])
def test_an_ascii_terminal_shows_any_name(place, name):
    scene = place.output / name
    scene.write_text((place.output / "scene.toml").read_text())
    ascii_only = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    code, output, errors = place.run("stats", scene, environment=ascii_only)
    assert (code, errors) == (0, "")
    assert output.isascii()
    assert "###" in output
    gone = place.run("stats", place.output / f"gone-{name}", environment=ascii_only)
    assert (gone[0], gone[1]) == (2, "")
    assert gone[2].startswith("clbvh: ")
