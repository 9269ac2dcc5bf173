"""Where the known meshes are looked for."""

from __future__ import annotations

import re

import pytest

from clbvh.errors import ConfigError, MeshError
from clbvh.geometry.fetch import KNOWN_MESHES, find_known_mesh
from clbvh.support.folders import find_cache


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Return an empty folder of the user and an empty cache, both in use."""
    meshes, cache = tmp_path / "meshes", tmp_path / "cache"
    meshes.mkdir()
    cache.mkdir()
    monkeypatch.setenv("CLBVH_MESHES", str(meshes))
    monkeypatch.setenv("CLBVH_CACHE", str(cache))
    return meshes, cache


@pytest.mark.parametrize(
    ("name", "file_names"),
    [
        ("bunny", ["bun_zipper.ply", "bunny.ply"]),
        ("dragon", ["dragon_vrip.ply", "dragon_871k.ply", "dragon.ply"]),
        ("drill", ["drill_shaft_zip.ply", "drill.ply"]),
    ],
)
def test_the_folder_comes_before_the_cache_and_the_best_name_first(folders, name, file_names):
    meshes, cache = folders
    (cache / file_names[0]).touch()
    assert find_known_mesh(name) == cache / file_names[0]
    for file_name in reversed(file_names):
        (meshes / file_name).touch()
        assert find_known_mesh(name) == meshes / file_name


@pytest.mark.parametrize("name", KNOWN_MESHES)
@pytest.mark.parametrize("folder_is_set", [True, False])
def test_what_is_missing_says_how_to_get_it(folders, monkeypatch, name, folder_is_set):
    if not folder_is_set:
        monkeypatch.delenv("CLBVH_MESHES")
    with pytest.raises(MeshError) as caught:
        find_known_mesh(name)
    message = str(caught.value)
    assert f"'clbvh fetch {name}'" in message
    assert "CLBVH_MESHES" in message
    assert KNOWN_MESHES[name].file_name in message
    assert (str(folders[0]) in message) == folder_is_set
    assert "\n" not in message


def test_a_folder_with_the_name_of_a_mesh_is_no_mesh(folders):
    (folders[0] / "bunny.ply").mkdir()
    with pytest.raises(MeshError):
        find_known_mesh("bunny")


def test_an_unknown_name():
    with pytest.raises(ConfigError, match="no known mesh 'teapot': the known ones are bunny, dragon, drill"):
        find_known_mesh("teapot")


def test_the_cache_has_a_place_of_its_own_by_default(monkeypatch):
    monkeypatch.delenv("CLBVH_CACHE", raising=False)
    assert "clbvh" in find_cache().parts[-1].lower() or "clbvh" in str(find_cache()).lower()


@pytest.mark.parametrize("mesh", KNOWN_MESHES.values(), ids=KNOWN_MESHES)
def test_each_known_mesh_has_a_sum(mesh):
    sums = [value for value in (mesh.archive_sha256, mesh.member_sha256) if value]
    assert sums
    assert all(re.fullmatch("[0-9a-f]{64}", value) for value in sums)
