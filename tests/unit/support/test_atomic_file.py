"""A file is whole or absent."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from clbvh.errors import ConfigError
from clbvh.support.files import check_target, remove_unfinished, replacing, temporary_folder, write_atomically


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


def test_a_link_is_followed_and_stays(tmp_path):
    (tmp_path / "real").write_bytes(b"old")
    (tmp_path / "link").symlink_to("real")
    write_atomically(tmp_path / "link", lambda file: file.write(b"new"))
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_bytes() == b"new"


def test_a_link_to_a_file_that_is_yet_to_be_makes_it(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder/new")
    write_atomically(tmp_path / "link", lambda file: file.write(b"new"))
    assert (tmp_path / "folder" / "new").read_bytes() == b"new"
    assert [path.name for path in (tmp_path / "folder").iterdir()] == ["new"]


def test_a_replaced_file_keeps_its_rights(tmp_path):
    (tmp_path / "a").touch(mode=0o600)
    write_atomically(tmp_path / "a", lambda file: file.write(b"secret"))
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("kind", ["device", "fifo", "socket", "link to a FIFO", "loop", "long name"])
def test_only_regular_files_are_targets(tmp_path, kind, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a socket's path is short
    path = tmp_path / ("a" * 300 if kind == "long name" else "a")
    if kind == "device":
        # A terminal of our own, in a folder where nobody can make files: a failing test replaces no device.
        path = Path(os.ttyname(os.openpty()[1]))
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as opened:
            opened.bind("a")
    elif kind == "link to a FIFO":
        os.mkfifo(tmp_path / "fifo")
        path.symlink_to("fifo")
    elif kind == "loop":
        path.symlink_to("a")
    before = list(tmp_path.iterdir())
    with pytest.raises(ConfigError, match=r"no file can be written there|only a regular file|leads nowhere"):
        write_atomically(path, lambda file: file.write(b"x"))
    assert list(tmp_path.iterdir()) == before


def test_a_read_only_folder_is_found_before_the_work(tmp_path):
    with pytest.raises(ConfigError, match="no file can be written into the folder"):
        check_target(Path("/proc/self/a"))


def test_a_full_disk_names_the_users_file(tmp_path):
    def fill(file):
        raise OSError(28, os.strerror(28), "/elsewhere/temporary")

    with pytest.raises(OSError, match="No space left on device") as caught:
        write_atomically(tmp_path / "a", fill)
    assert caught.value.filename == str(tmp_path / "a")


def test_names_as_long_as_the_system_allows_can_be_written(tmp_path):
    write_atomically(tmp_path / ("a" * 255), lambda file: file.write(b"x"))
    assert [len(path.name) for path in tmp_path.iterdir()] == [255]


def test_what_a_signal_interrupts_is_removed(tmp_path):
    def begin():
        with replacing(tmp_path / "a"), temporary_folder(tmp_path, "b-") as folder:
            (folder / "inner").touch()
            assert len(list(tmp_path.iterdir())) == 2
            remove_unfinished()
            assert list(tmp_path.iterdir()) == []

    with pytest.raises(FileNotFoundError):
        begin()
