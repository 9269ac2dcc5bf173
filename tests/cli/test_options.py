"""Options that several verbs share."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import get_args

import pytest

from clbvh import BuildOptions, RenderOptions
from clbvh.builders.tree_options import TreeOptions
from clbvh.cli import options

from .command import run_clbvh


def test_given_options_and_no_others_change_those_of_the_library(tmp_path):
    assert options.make_options(RenderOptions, {}) == RenderOptions()
    given = {"leaf_size": 8, "quality": "fast", "workers": 2, "cache_dir": tmp_path, "layout": "bvh4", "device": "cpu"}
    assert options.make_options(RenderOptions, given) == RenderOptions(
        build=BuildOptions(leaf_size=8, quality="fast"), workers=2, cache=tmp_path, layout="bvh4", device="cpu"
    )


@pytest.mark.parametrize("kind", [BuildOptions, TreeOptions, RenderOptions])
def test_every_option_has_its_text_and_its_default(kind):
    made = options.list_tree_options(kind)
    assert made.keys() >= {field.name for field in fields(kind)} - {"build"}
    for name, option in made.items():
        (parameter,) = option.__metadata__
        assert parameter.help, name
        default = next((field.default for field in fields(kind) if field.name == name), None)
        if default is not None and default is not False and name != "cache":
            assert type(default)(parameter.show_default) == default
        value_type = get_args(option)[0]
        assert value_type in (str, int, float, bool, Path)
        assert default is None or isinstance(default, value_type)


def test_the_folder_of_the_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("CLBVH_CACHE", str(tmp_path))
    assert options.find_cache_folder(False, None) is None
    assert options.find_cache_folder(True, None) == tmp_path / "trees"
    assert options.find_cache_folder(True, Path("there")) == Path("there")
    assert options.find_cache_folder(False, Path("there")) == Path("there")


BUILD = {"builder", "workers", "bins", "leaf-size", "traversal-cost", "task-threshold", "frontier", "quality", "json"}


@pytest.mark.parametrize(
    ("verb", "others"), [("stats", ()), *((verb, ("cache-dir", "layout")) for verb in ("render", "images", "sheet"))]
)
def test_verbs_have_the_options_of_a_build(verb, others):
    text = run_clbvh(verb, "--help", COLUMNS="200", NO_COLOR="1").stdout
    for option in BUILD | set(others):
        assert f"--{option} " in text


def test_brackets_and_quotes_of_texts_are_no_markup():
    text = " ".join(run_clbvh("render", "--help", COLUMNS="200", NO_COLOR="1").stdout.split())
    assert "bvh2, bvh4, bvh8, or auto" in text
    assert "`" not in text.replace("`clbvh devices`", "")
