"""Warnings on the command line: ours are one line, and those of others are shown as always."""

import warnings

import pytest

import clbvh
from clbvh.cli.warning_lines import warnings_as_lines


def test_a_warning_about_a_file_is_one_line(capsys):
    with warnings_as_lines():
        for _ in range(2):
            warnings.warn("a.obj: the texture is missing", clbvh.AppearanceWarning, stacklevel=1)
    assert capsys.readouterr().err == "clbvh: warning: a.obj: the texture is missing\n" * 2


def test_other_warnings_are_left_alone():
    with pytest.warns(ResourceWarning, match="open"), warnings_as_lines():
        warnings.warn("left open", ResourceWarning, stacklevel=1)
