"""A file is whole or absent."""

from __future__ import annotations

import pytest

from clbvh.errors import ConfigError
from clbvh.support.atomic_file import check_target, write_atomically


def test_a_file_is_written_or_replaced(tmp_path):
    for content in (b"old and longer", b"new"):
        write_atomically(tmp_path / "a", lambda file, content=content: file.write(content))
        assert (tmp_path / "a").read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("problem", [OSError("no space"), KeyboardInterrupt()])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, problem):
    (tmp_path / "a").write_bytes(b"old")

    def fail(file):
        file.write(b"half")
        raise problem

    with pytest.raises(type(problem)):
        write_atomically(tmp_path / "a", fail)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_bytes() == b"old"


def test_the_real_name_never_holds_half_a_file(tmp_path):
    write_atomically(tmp_path / "a", lambda file: file.write(str((tmp_path / "a").exists()).encode()))
    assert (tmp_path / "a").read_bytes() == b"False"


def test_a_new_file_has_the_rights_of_any_other(tmp_path):
    write_atomically(tmp_path / "a", lambda file: file.write(b"x"))
    (tmp_path / "other").touch()
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_targets_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="does not exist"):
        check_target(tmp_path / "gone" / "a")
    with pytest.raises(ConfigError, match="this is a folder"):
        check_target(tmp_path)
    check_target(tmp_path / "a")
