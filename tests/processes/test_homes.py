"""A home, a cache, or a folder for temporary files that cannot be used."""

from __future__ import annotations

import pytest

from .place import Place, scene_in


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return scene_in(Place(tmp_path_factory.mktemp("h")))


@pytest.fixture
def homeless(place):
    """The environment of a user whose home can hold no cache; machine code alone is kept elsewhere, to save time."""
    file = place.folder / "file"
    file.touch()
    unset = dict.fromkeys(("XDG_CACHE_HOME", "CLBVH_CACHE", "POCL_CACHE_DIR"), "")
    return {"HOME": str(file / "home"), **unset}


def test_a_picture_needs_no_home_and_that_is_said_once(place, homeless):
    words = ("render", "scene.toml", "-o", "a.ppm", "--workers", 2, "--cache")
    expected = place.run(*words)
    assert expected[0] == 0, expected[2]
    picture = (place.output / "a.ppm").read_bytes()
    (place.output / "a.ppm").unlink()
    code, output, errors = place.run(*words, environment=homeless)
    assert code == 0, errors
    assert "triangles" in output
    (line,) = errors.splitlines()
    assert line.startswith("clbvh: nothing can be kept in the cache ")
    assert (place.output / "a.ppm").read_bytes() == picture
    assert place.leftovers() == []


def test_a_folder_for_temporary_files_that_is_not_there_is_no_matter(place):
    nowhere = {"TMPDIR": str(place.folder / "nowhere")}
    code, _, errors = place.run("render", "scene.toml", "-o", "b.ppm", "--workers", 2, environment=nowhere)
    assert (code, errors) == (0, "")
