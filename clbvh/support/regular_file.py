"""Input files: opened only if they are regular, and read no further than their size allows."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from .memory import free_memory_bytes

_KINDS = {
    stat.S_IFDIR: "folder",
    stat.S_IFIFO: "named pipe",
    stat.S_IFSOCK: "socket",
    stat.S_IFCHR: "device",
    stat.S_IFBLK: "device",
}


def open_regular(path: Path) -> BufferedReader:
    """Open a regular file, or a link to one, for reading.

    Raises
    ------
    OSError
        The file cannot be opened, or is not a regular one: a named pipe would wait for a writer, and a device may have
        no end. `strerror` says so in one phrase.
    """
    _refuse_special(path, path.stat().st_mode)
    # Not blocking: the name may have become a pipe's since.
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        _refuse_special(path, os.fstat(descriptor).st_mode)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


@contextmanager
def read_errors_as(kind: type[Exception], path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn the errors of opening and reading a file into errors of one kind, which name it; those of the kind pass."""
    try:
        yield
    except kind:
        raise
    except FileNotFoundError:
        raise kind(f"{path}: no such file") from None
    except (TypeError, ValueError) as error:
        raise kind(f"{path!r}: this is not the path of a file: {error}") from error
    except OSError as error:
        raise kind(f"{path}: the file cannot be read: {error.strerror or error}") from error


def read_regular(path: Path, *, max_bytes: int | None = None) -> bytes:
    """Return the content of a regular file: as many bytes as its size says.

    Parameters
    ----------
    path : Path
    max_bytes : int, optional
        The largest size; the free memory without it.

    Raises
    ------
    OSError
        See `open_regular`; also if the file is larger.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if max_bytes is not None and size > max_bytes:
            raise OSError(errno.EFBIG, f"it has {size:,} bytes, more than the {max_bytes:,} expected", str(path))
        if size > (free := free_memory_bytes()):
            raise OSError(errno.EFBIG, f"it has {size:,} bytes, but there are {free:,} bytes of free memory", str(path))
        return file.read(size)


def _refuse_special(path: Path, mode: int) -> None:
    kind = stat.S_IFMT(mode)
    if kind != stat.S_IFREG:
        code = errno.EISDIR if kind == stat.S_IFDIR else errno.EINVAL
        raise OSError(code, f"this is a {_KINDS.get(kind, 'special file')}, not a file", str(path))
