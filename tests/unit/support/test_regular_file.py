"""Input files: regular ones and links to them are read, everything else is refused at once."""

from __future__ import annotations

import os
import socket

import pytest

from clbvh.support import files as regular_file
from clbvh.support.files import open_regular, read_regular


@pytest.fixture(params=["folder", "named pipe", "socket", "device"])
def special(request, short_path):
    """A path that is no regular file, and the name of its kind."""
    path = short_path / "a"
    match request.param:
        case "folder":
            path.mkdir()
        case "named pipe":
            os.mkfifo(path)
        case "socket":
            with socket.socket(socket.AF_UNIX) as opened:
                opened.bind(str(path))
        case "device":
            path.symlink_to("/dev/zero")
    return path, request.param


def test_a_special_file_is_refused_by_its_kind(special):
    path, kind = special
    with pytest.raises(OSError, match=f"this is a {kind}, not a file"):
        open_regular(path)
    with pytest.raises(OSError, match=f"this is a {kind}, not a file"):
        read_regular(path)


def test_a_link_to_a_file_is_a_file(tmp_path):
    (tmp_path / "a").write_bytes(b"content")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert read_regular(tmp_path / "b") == b"content"
    assert read_regular(tmp_path / "a", max_bytes=7) == b"content"
    with pytest.raises(OSError, match="7 bytes, more than the 6"):
        read_regular(tmp_path / "a", max_bytes=6)


def test_a_file_larger_than_the_free_memory(tmp_path, monkeypatch):
    (tmp_path / "a").write_bytes(b"content")
    monkeypatch.setattr(regular_file, "free_memory_bytes", lambda: 6)
    with pytest.raises(OSError, match="7 bytes, but there are 6 bytes of free memory"):
        read_regular(tmp_path / "a")


def test_a_file_without_blocks_is_not_believed(tmp_path):
    with (tmp_path / "a").open("wb") as file:
        file.truncate(1 << 42)
    with pytest.raises(OSError, match="free memory"):
        read_regular(tmp_path / "a")
