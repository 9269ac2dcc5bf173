"""Options that several verbs share, and what the help says of them."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import get_args

from clbvh import BuildOptions, RenderOptions
from clbvh.builders.tree_options import TreeOptions
from clbvh.cli import options

from .command import run_clbvh

BUILD = {"builder", "workers", "bins", "leaf-size", "traversal-cost", "task-threshold", "frontier", "quality", "json"}


def test_given_options_and_no_others_change_those_of_the_library(tmp_path):
    assert options.make_options(RenderOptions, {}) == RenderOptions()
    given = {"leaf_size": 8, "quality": "fast", "workers": 2, "cache_dir": tmp_path, "layout": "bvh4", "device": "cpu"}
    assert options.make_options(RenderOptions, given) == RenderOptions(
        build=BuildOptions(leaf_size=8, quality="fast"), workers=2, cache=tmp_path, layout="bvh4", device="cpu"
    )


def test_every_option_has_its_text_and_its_default():
    for kind in (BuildOptions, TreeOptions, RenderOptions):
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


def test_the_help_names_them_without_markup():
    for verb in ("stats", "render", "images", "sheet"):
        text = run_clbvh(verb, "--help", COLUMNS="200", NO_COLOR="1").stdout
        for option in BUILD | (set() if verb == "stats" else {"cache-dir", "layout"}):
            assert f"--{option} " in text
    assert "bvh2, bvh4, bvh8, or auto" in " ".join(text.split())
    assert "`" not in text.replace("`clbvh devices`", "")
