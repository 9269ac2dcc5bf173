"""Trees that are built, and trees that come from the cache; nothing about the cache is ever fatal."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clbvh import BuildOptions, Bvh, Mesh, RenderOptions, build, validate_tree
from clbvh.builders.tree_cache import cache_path, find_tree_cache, get_tree
from clbvh.builders.tree_options import TreeOptions
from clbvh.errors import ConfigError

from ...soup import make_soup

MESH = make_soup(500, 1)


@pytest.fixture
def cached(tmp_path):
    """Options with a cache in a folder that does not exist yet."""
    return TreeOptions(cache=tmp_path / "some" / "folder")


def make(options, mesh=MESH):
    return get_tree(mesh, options)


def file_of(options, mesh=MESH):
    return cache_path(options.cache, mesh, options.builder, options.build)


def test_without_a_cache_the_tree_is_built(tmp_path):
    made = make(TreeOptions(build=BuildOptions(leaf_size=1)))
    assert made.bvh.nodes.tobytes() == build(MESH, leaf_size=1).nodes.tobytes()
    assert (made.from_cache, made.workers, made.notes) == (False, 1, ())
    assert made.timings_ms["build"] > 0
    assert made.timings_ms["cache"] == 0


def test_the_second_time_the_tree_comes_from_the_cache(cached):
    first, second = make(cached), make(cached)
    assert (first.from_cache, second.from_cache) == (False, True)
    assert second.bvh.nodes.tobytes() == first.bvh.nodes.tobytes()
    assert second.bvh.prim_ids.tobytes() == first.bvh.prim_ids.tobytes()
    assert (second.workers, second.notes) == (0, ())
    assert second.timings_ms["build"] == 0 < second.timings_ms["cache"]
    assert [path.name for path in cached.cache.iterdir()] == [file_of(cached).name]


def test_a_mesh_of_another_name_has_the_same_tree(cached):
    make(cached)
    assert make(cached, dataclasses.replace(MESH, name="other")).from_cache


@pytest.mark.parametrize(
    "change",
    [
        {"build": BuildOptions(bins=8)},
        {"build": BuildOptions(leaf_size=1)},
        {"build": BuildOptions(traversal_cost=2.0)},
        {"build": BuildOptions(quality="fast")},
    ],
)
def test_other_options_have_another_tree(cached, change):
    make(cached)
    other = dataclasses.replace(cached, **change)
    made = make(other)
    assert not made.from_cache
    assert make(other).bvh.nodes.tobytes() == made.bvh.nodes.tobytes() != make(cached).bvh.nodes.tobytes()


def test_every_option_but_the_threshold_is_in_the_name(tmp_path):
    """Also those that the future brings."""
    other = {int: 5, float: 5.0, type(None): 5, str: "fast"}
    names = {cache_path(tmp_path, MESH, "sah", BuildOptions()), cache_path(tmp_path, MESH, "another", BuildOptions())}
    fields = [field for field in dataclasses.fields(BuildOptions) if field.name != "task_threshold"]
    for field in fields:
        changed = BuildOptions(**{field.name: other[type(field.default)]})
        names.add(cache_path(tmp_path, MESH, "sah", changed))
    assert len(names) == 2 + len(fields)
    threshold = BuildOptions(task_threshold=5)
    assert cache_path(tmp_path, MESH, "sah", threshold) == cache_path(tmp_path, MESH, "sah", BuildOptions())


def test_another_version_builds_again(cached, monkeypatch):
    make(cached)
    monkeypatch.setattr("clbvh.builders.tree_cache.__version__", "99.0")
    assert not make(cached).from_cache


@pytest.mark.parametrize("damage", [lambda data: data[:-1], lambda data: data + b"x", lambda data: b"", bytes.upper])
def test_a_damaged_file_is_replaced(cached, damage):
    make(cached)
    path = file_of(cached)
    good = path.read_bytes()
    path.write_bytes(damage(good))
    made = make(cached)
    assert not made.from_cache
    (note,) = made.notes
    assert str(path) in note
    assert "built again" in note
    validate_tree(made.bvh)
    assert path.read_bytes() == good
    assert make(cached).from_cache


def test_the_file_of_another_mesh_is_not_used(cached):
    other = Mesh.from_arrays(MESH.vertices * [1, 1, 2], MESH.faces)
    make(cached, other)
    file_of(cached, other).rename(file_of(cached))
    made = make(cached)
    assert not made.from_cache
    assert "another mesh" in made.notes[0]
    validate_tree(made.bvh)


def test_a_folder_in_the_place_of_the_file_is_no_end(cached):
    file_of(cached).mkdir(parents=True)
    made = make(cached)
    assert not made.from_cache
    assert len(made.notes) == 2
    assert "this is a folder" in made.notes[1]
    validate_tree(made.bvh)


def test_a_full_disk_is_no_end(cached, monkeypatch):
    def fail(bvh, path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Bvh, "save", fail)
    (note,) = make(cached).notes
    assert "cannot be kept" in note
    assert "No space left" in note


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="trees cannot be kept in this folder"):
        make(TreeOptions(cache=tmp_path / "file" / "folder"))


def test_the_cache_lies_in_the_cache_of_the_user(monkeypatch, tmp_path):
    monkeypatch.setenv("CLBVH_CACHE", str(tmp_path))
    assert find_tree_cache() == tmp_path / "trees"


def test_threads_fill_the_cache_with_the_same_tree(cached):
    wanted = dataclasses.replace(cached, workers=2, build=BuildOptions(task_threshold=100))
    made = make(wanted)
    assert (made.workers, made.from_cache) == (2, False)
    again = make(cached)
    assert again.from_cache
    assert (again.bvh.nodes == made.bvh.nodes).all()
    assert np.array_equal(again.bvh.prim_ids, build(MESH).prim_ids)


def test_options_are_checked():
    with pytest.raises(ConfigError, match="not 'brute'"):
        TreeOptions(builder="brute")
    assert RenderOptions(builder="brute").builder == "brute"
    for kind in (TreeOptions, RenderOptions):
        with pytest.raises(ConfigError, match="not 'magic'"):
            kind(builder="magic")
        with pytest.raises(ConfigError, match="workers must be 1 to 1024, not 0"):
            kind(workers=0)
        with pytest.raises(ConfigError, match="workers must be a whole number, not 'two'"):
            kind(workers="two")
        with pytest.raises(ConfigError, match=r"cache must be a pathlib\.Path or None"):
            kind(cache="folder")
