"""Files that are whole or absent, inputs that are files, memory that is free, and sentences for the user."""

import logging
import os
from types import SimpleNamespace

import pytest

from clbvh import ConfigError, MeshError
from clbvh.support import files, memory
from clbvh.support.files import (
    open_regular,
    read_regular,
    remove_unfinished,
    replacing,
    temporary_folder,
    write_atomically,
)
from clbvh.support.memory import check_memory, free_memory_bytes
from clbvh.support.say_once import say_compiling, say_once


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_written_or_replaced_with_its_rights_and_never_half_of_it(tmp_path):
    path = tmp_path / "a"
    write_atomically(path, lambda file: file.write(str(path.exists()).encode()))
    assert path.read_bytes() == b"False"
    (tmp_path / "other").touch()
    assert path.stat().st_mode == (tmp_path / "other").stat().st_mode
    path.chmod(0o600)
    write_atomically(path, lambda file: file.write(b"new"))
    assert path.read_bytes() == b"new"
    assert path.stat().st_mode & 0o777 == 0o600
    # Also with the longest name that the system allows.
    write_atomically(tmp_path / ("b" * 255), lambda file: file.write(b"x"))
    assert names_in(tmp_path) == ["a", "b" * 255, "other"]


@pytest.mark.parametrize("problem", [OSError(28, os.strerror(28), "/elsewhere/temporary"), KeyboardInterrupt()])
def test_a_failure_leaves_the_old_file_and_nothing_else_and_names_the_users_file(tmp_path, problem):
    (tmp_path / "a").write_bytes(b"old")

    def fail(file):
        file.write(b"half")
        raise problem

    with pytest.raises(type(problem)) as caught:
        write_atomically(tmp_path / "a", fail)
    assert getattr(caught.value, "filename", str(tmp_path / "a")) == str(tmp_path / "a")
    assert names_in(tmp_path) == ["a"]
    assert (tmp_path / "a").read_bytes() == b"old"


def test_what_a_signal_interrupts_is_removed(tmp_path):
    def begin():
        with replacing(tmp_path / "a"), temporary_folder(tmp_path, "b-") as folder:
            (folder / "inner").touch()
            assert len(names_in(tmp_path)) == 2
            remove_unfinished()
            assert names_in(tmp_path) == []

    with pytest.raises(FileNotFoundError):
        begin()


def test_a_link_is_followed_and_stays(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder/new")
    for content in (b"first", b"second"):
        write_atomically(tmp_path / "link", lambda file, content=content: file.write(content))
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "folder/new").read_bytes() == content
    assert names_in(tmp_path / "folder") == ["new"]


def make_special(path, kind):
    """A path that is no regular file."""
    match kind:
        case "folder":
            path.mkdir()
        case "named pipe":
            os.mkfifo(path)
        case "device":
            # A terminal of our own, in a folder where nobody can make files: a failing test replaces no device.
            path.symlink_to(os.ttyname(os.openpty()[1]))
        case "loop":
            path.symlink_to(path.name)
        case "link to a pipe":
            os.mkfifo(path.with_name("pipe"))
            path.symlink_to("pipe")


# What a reader says of each.
KINDS = {
    "folder": "this is a folder, not a file",
    "named pipe": "this is a named pipe, not a file",
    "device": "this is a device, not a file",
    "link to a pipe": "this is a named pipe, not a file",
    "loop": "symbolic links",
    "long name": "too long",
}


@pytest.mark.parametrize("kind", KINDS)
def test_only_regular_files_are_written_and_read(short_path, kind):
    path = short_path / ("a" * 300 if kind == "long name" else "a")
    make_special(path, kind)
    before = names_in(short_path)
    with pytest.raises(ConfigError, match=r"no file can be|only a regular file|leads nowhere|this is a folder"):
        write_atomically(path, lambda file: file.write(b"x"))
    assert names_in(short_path) == before
    for read in (open_regular, read_regular):
        with pytest.raises(OSError, match=KINDS[kind]):
            read(path)


def test_a_link_to_a_file_is_read_and_what_is_too_large_is_not(tmp_path, monkeypatch):
    (tmp_path / "a").write_bytes(b"content")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert read_regular(tmp_path / "b", max_bytes=7) == b"content"
    with pytest.raises(OSError, match="7 bytes, more than the 6"):
        read_regular(tmp_path / "a", max_bytes=6)
    with (tmp_path / "without blocks").open("wb") as file:
        file.truncate(1 << 42)
    with pytest.raises(OSError, match="free memory"):
        read_regular(tmp_path / "without blocks")
    monkeypatch.setattr(files, "free_memory_bytes", lambda: 6)
    with pytest.raises(OSError, match="7 bytes, but there are 6 bytes of free memory"):
        read_regular(tmp_path / "a")


GIB = 1 << 30


def test_free_memory_is_the_least_of_what_the_system_and_a_container_leave(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "_CONTAINER", tmp_path)
    monkeypatch.setattr(memory.psutil, "virtual_memory", lambda: SimpleNamespace(available=8 * GIB))
    assert free_memory_bytes() == 8 * GIB
    # A container's pages of files count as free.
    for most, taken, stat, expected in [
        ("max", 5, "anon 5\n", 8 * GIB),
        (4 * GIB, 3 * GIB, f"anon 5\ninactive_file {GIB // 2}\n", 3 * GIB // 2),
        (5, 6, "anon 5\n", 0),
        ("max", 0, "", 8 * GIB),
    ]:
        for name, text in {"memory.max": most, "memory.current": taken, "memory.stat": stat}.items():
            (tmp_path / name).write_text(f"{text}\n")
        assert free_memory_bytes() == expected
    check_memory("a mesh", 8 * GIB, MeshError)
    with pytest.raises(MeshError, match="a mesh needs about 8,590 MB of memory, but 8,590 MB are free: take less"):
        check_memory("a mesh", 8 * GIB + 1, MeshError, "take less")


def test_a_reason_to_wait_is_on_stderr_once_however_the_program_logs(monkeypatch, capsys):
    for handlers, of_any_sentence in (([], 1), ([logging.StreamHandler()], 1), ([logging.NullHandler()], 0)):
        monkeypatch.setenv("_CLBVH_SAID", "")
        monkeypatch.setattr(logging.getLogger(), "handlers", handlers)
        for _ in range(2):
            say_compiling()
        line = "clbvh: compiling for this machine; `clbvh warmup` does it ahead\n"
        assert capsys.readouterr().err == line
        say_once("a cache that cannot be used")
        assert len(capsys.readouterr().err.splitlines()) == of_any_sentence
