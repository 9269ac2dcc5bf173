"""Options that several verbs share."""

from __future__ import annotations

from pathlib import Path

import pytest

from clbvh import BuildOptions
from clbvh.builders.tree_cache import TreeOptions
from clbvh.cli import options

from .command import run_clbvh


def test_the_defaults_are_those_of_the_library():
    assert TreeOptions().builder == options.DEFAULT_BUILDER
    made = BuildOptions(
        None,
        options.DEFAULT_LEAF_SIZE,
        options.DEFAULT_TRAVERSAL_COST,
        None,
        options.DEFAULT_FRONTIER,
        options.DEFAULT_QUALITY,
    )
    assert made == BuildOptions()


def test_the_folder_of_the_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("CLBVH_CACHE", str(tmp_path))
    assert options.find_cache_folder(False, None) is None
    assert options.find_cache_folder(True, None) == tmp_path / "trees"
    assert options.find_cache_folder(True, Path("there")) == Path("there")
    assert options.find_cache_folder(False, Path("there")) == Path("there")


@pytest.mark.parametrize("verb", ["render", "stats"])
def test_both_verbs_have_the_options_of_a_build(verb):
    text = run_clbvh(verb, "--help", COLUMNS="200", NO_COLOR="1").stdout
    for option in (
        "--builder",
        "--workers",
        "--bins",
        "--leaf-size",
        "--traversal-cost",
        "--task-threshold",
        "--frontier",
        "--quality",
        "--json",
    ):
        assert option in text
