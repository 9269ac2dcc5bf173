"""The folder of kept trees has a limit: what has not been used for the longest time goes first."""

from __future__ import annotations

import os

import pytest

from clbvh import build, make_shape
from clbvh.builders.options import BuildOptions
from clbvh.builders.tree_cache import LIMIT_VARIABLE, cache_path, keep_tree, take_tree

MIB = 1 << 20


@pytest.fixture(scope="module")
def mesh():
    return make_shape("icosphere", triangles=1280)


@pytest.fixture(scope="module")
def tree(mesh):
    return build(mesh)


def keep_aged(folder, mesh, tree, count):
    """Keep a tree under several names, the first one used the longest time ago; each takes a whole MiB."""
    paths = [cache_path(folder, mesh, "sah", BuildOptions(bins=bins)) for bins in range(2, 2 + count)]
    for age, path in enumerate(reversed(paths), start=1):
        tree.save(path)
        with path.open("ab") as file:
            file.truncate(MIB)
        os.utime(path, (1e9 - age, 1e9 - age))
    return paths


def test_the_oldest_trees_go_first(tmp_path, mesh, tree, monkeypatch):
    monkeypatch.setenv(LIMIT_VARIABLE, "3")
    paths = keep_aged(tmp_path, mesh, tree, 4)
    new = cache_path(tmp_path, mesh, "sah", BuildOptions())
    (tmp_path / "not-a-tree").write_bytes(bytes(5 * MIB))
    assert keep_tree(new, tree) == ""
    assert set(tmp_path.iterdir()) == {*paths[2:], new, tmp_path / "not-a-tree"}


def test_a_tree_that_is_used_stays(tmp_path, mesh, tree, monkeypatch):
    monkeypatch.setenv(LIMIT_VARIABLE, "3")
    paths = keep_aged(tmp_path, mesh, tree, 3)
    tree.save(paths[0])  # whole again, so that it can be taken
    os.utime(paths[0], (0, 0))
    taken, note = take_tree(paths[0], mesh)
    assert (taken is not None, note) == (True, "")
    with paths[0].open("ab") as file:
        used = paths[0].stat().st_mtime
        file.truncate(MIB)
    os.utime(paths[0], (used, used))
    assert keep_tree(cache_path(tmp_path, mesh, "sah", BuildOptions()), tree) == ""
    assert paths[0].exists()
    assert not paths[1].exists()


def test_a_tree_above_the_limit_is_not_kept(tmp_path, mesh, tree, monkeypatch):
    monkeypatch.setenv(LIMIT_VARIABLE, "0")
    path = cache_path(tmp_path, mesh, "sah", BuildOptions())
    assert f"set {LIMIT_VARIABLE} to more" in keep_tree(path, tree)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("limit", ["many", "-1", "1e3", "9" * 5000])
def test_a_limit_that_is_no_number_is_said(tmp_path, mesh, tree, monkeypatch, limit):
    monkeypatch.setenv(LIMIT_VARIABLE, limit)
    path = cache_path(tmp_path, mesh, "sah", BuildOptions())
    assert keep_tree(path, tree).startswith(f"{LIMIT_VARIABLE} must be a whole number of MiB")
    assert path.exists()


def test_a_fifo_in_the_place_of_a_tree_is_not_read(tmp_path, mesh, tree):
    path = cache_path(tmp_path, mesh, "sah", BuildOptions())
    os.mkfifo(path)
    taken, note = take_tree(path, mesh)
    assert taken is None
    assert note.endswith("this is a named pipe, not a file")
    assert "only a regular file can be replaced" in keep_tree(path, tree)
