"""Trees that are built or come from the cache: nothing about the cache is ever fatal, and its folder has a limit."""

from __future__ import annotations

import dataclasses
import os
from unittest.mock import Mock

import pytest

from clbvh import BuildOptions, Bvh, ConfigError, Mesh, RenderOptions, build
from clbvh.builders.tree_cache import LIMIT_VARIABLE, cache_path, get_tree, keep_tree, take_tree
from clbvh.builders.tree_options import TreeOptions

MIB = 1 << 20


@pytest.fixture
def cached(tmp_path):
    """Options with a cache in a folder that does not exist yet."""
    return TreeOptions(cache=tmp_path / "some" / "folder")


@pytest.fixture
def path(cached, mesh):
    """Where the cache keeps the knot's tree."""
    return cache_path(cached.cache, mesh, cached.builder, cached.build)


def test_the_second_time_the_tree_comes_from_the_cache(cached, mesh, path):
    threads = dataclasses.replace(cached, workers=2, build=BuildOptions(task_threshold=100))
    first, second = get_tree(mesh, threads), get_tree(dataclasses.replace(mesh, name="other"), cached)
    assert (first.from_cache, first.workers) == (False, 2)
    assert (second.from_cache, second.workers, second.notes) == (True, 0, ())
    assert second.bvh.nodes.tobytes() == first.bvh.nodes.tobytes() == build(mesh).nodes.tobytes()
    assert second.bvh.prim_ids.tobytes() == first.bvh.prim_ids.tobytes()
    assert second.timings_ms["build"] == 0 < second.timings_ms["cache"]
    assert list(cached.cache.iterdir()) == [path]


def test_every_option_but_the_threshold_is_in_the_name(tmp_path, mesh):
    """Also those that the future brings."""
    other = {int: 5, float: 5.0, type(None): 5, str: "fast"}
    fields = [field for field in dataclasses.fields(BuildOptions) if field.name != "task_threshold"]
    changed = [BuildOptions(), *(BuildOptions(**{field.name: other[type(field.default)]}) for field in fields)]
    names = {cache_path(tmp_path, mesh, "sah", options) for options in changed}
    assert len(names | {cache_path(tmp_path, mesh, "another", BuildOptions())}) == 2 + len(fields)
    assert cache_path(tmp_path, mesh, "sah", BuildOptions(task_threshold=5)) in names


def test_a_damaged_file_and_that_of_another_mesh_are_replaced(cached, mesh, path, monkeypatch):
    get_tree(mesh, cached)
    good = path.read_bytes()
    build(Mesh.from_arrays(mesh.vertices * [1, 1, 2], mesh.faces)).save(path)
    other = path.read_bytes()
    for content, words in ((good[:-1], "built again"), (b"", "built again"), (other, "another mesh")):
        path.write_bytes(content)
        made = get_tree(mesh, cached)
        assert not made.from_cache
        (note,) = made.notes
        assert str(path) in note
        assert words in note
        assert made.bvh.nodes.tobytes() == build(mesh).nodes.tobytes()
        assert path.read_bytes() == good
    monkeypatch.setattr("clbvh.builders.tree_cache.__version__", "99.0")
    assert not get_tree(mesh, cached).from_cache


def test_a_folder_or_a_pipe_in_the_place_of_the_file_and_a_full_disk_are_no_end(cached, mesh, path, monkeypatch):
    path.mkdir(parents=True)
    made = get_tree(mesh, cached)
    assert (made.from_cache, len(made.notes)) == (False, 2)
    assert "this is a folder" in made.notes[1]
    path.rmdir()
    os.mkfifo(path)
    assert "this is a named pipe, not a file" in get_tree(mesh, cached).notes[0]
    path.unlink()
    monkeypatch.setattr(Bvh, "save", Mock(side_effect=OSError(28, "No space left on device")))
    (note,) = get_tree(mesh, cached).notes
    assert "cannot be kept" in note
    assert "No space left" in note


def test_the_trees_that_have_not_been_used_for_the_longest_time_go_first(tmp_path, mesh, monkeypatch):
    monkeypatch.setenv(LIMIT_VARIABLE, "3")
    tree = build(mesh)
    paths = [cache_path(tmp_path, mesh, "sah", BuildOptions(bins=bins)) for bins in (2, 3, 4, 5)]
    for age, path in enumerate(paths):
        tree.save(path)
        os.utime(path, (age, age))
    assert take_tree(paths[0], mesh)[0] is not None  # used, so the second is the oldest now
    for path in paths:
        used = path.stat().st_mtime
        os.truncate(path, MIB)
        os.utime(path, (used, used))
    (tmp_path / "not-a-tree").write_bytes(bytes(5 * MIB))
    new = cache_path(tmp_path, mesh, "sah", BuildOptions())
    assert keep_tree(new, tree) == ""
    assert set(tmp_path.iterdir()) == {paths[0], paths[3], new, tmp_path / "not-a-tree"}
    monkeypatch.setenv(LIMIT_VARIABLE, "0")
    assert f"set {LIMIT_VARIABLE} to more" in keep_tree(tmp_path / "one.tree", tree)
    for limit in ("-1", "1e3", "9" * 5000):
        monkeypatch.setenv(LIMIT_VARIABLE, limit)
        assert keep_tree(new, tree).startswith(f"{LIMIT_VARIABLE} must be a whole number of MiB")


def test_options_are_checked(tmp_path, mesh):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="trees cannot be kept in this folder"):
        get_tree(mesh, TreeOptions(cache=tmp_path / "file" / "folder"))
    with pytest.raises(ConfigError, match="the builder brute has one quality"):
        RenderOptions(builder="brute", build=BuildOptions(quality="fast"))
    for kind in (TreeOptions, RenderOptions):
        for name, value in (("builder", "magic"), ("workers", 0), ("workers", "two"), ("cache", "folder")):
            with pytest.raises(ConfigError, match=f"{name} must be "):
                kind(**{name: value})
