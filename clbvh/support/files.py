"""Files and folders: input that is read no further than its size allows, output that is complete or absent.

Input files are opened only if they are regular. Every file that clbvh writes for the user or for a later run is written
under a temporary name, then renamed; downloads arrive in a temporary folder of the cache.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from ..errors import ConfigError
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
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode):
        code = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
        raise OSError(code, f"this is a {_KINDS.get(stat.S_IFMT(mode), 'special file')}, not a file", str(path))
    return path.open("rb")


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


# Random bytes in a name.
_NAME_BYTES = 8

# Temporary files and folders, which the process must not leave behind.
_unfinished: set[Path] = set()


def as_path(path: str | os.PathLike[str]) -> Path:
    """Return a user's path as a `Path`; raise `ConfigError` if it is no path."""
    try:
        return Path(path)
    except TypeError as error:
        raise ConfigError(f"this is not the path of a file: give a path, not {path!r}") from error


def check_target(path: str | os.PathLike[str], what: str = "", suffixes: Iterable[str] = ()) -> Path:
    """Return a path; raise `ConfigError` unless a file can be written there. For checks before the work begins.

    A link is followed. Only a regular file can be replaced: no device such as ``/dev/null``, no FIFO, no socket. Where
    there are suffixes, the name must end in one of them; `what` says what the file is, with its article.
    """
    path = as_path(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise ConfigError(f"{path}: the name of {what} must end in {', '.join(suffixes)}")
    if "\0" in str(path):
        raise ConfigError(f"{str(path)!r}: this is not the path of a file")
    target = _follow(path)
    if not target.parent.is_dir():
        raise ConfigError(f"{path}: the folder {target.parent} does not exist")
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise ConfigError(f"{path}: no file can be written into the folder {target.parent}")
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return path
    except OSError as error:
        raise ConfigError(f"{path}: no file can be written there: {error.strerror or error}") from error
    if stat.S_ISDIR(mode):
        raise ConfigError(f"{path}: this is a folder, not a file")
    if not stat.S_ISREG(mode):
        raise ConfigError(f"{path}: this is a device, a FIFO or a socket: only a regular file can be replaced")
    if not os.access(target, os.W_OK):
        raise ConfigError(f"{path}: this file is read-only")
    return path


def write_atomically(path: str | os.PathLike[str], write: Callable[[BinaryIO], object]) -> None:
    """Write a file so that its name never refers to an incomplete one.

    Parameters
    ----------
    path : str or path
        A regular file of this name is replaced once the new one is complete, and keeps its permissions. A link stays,
        and the file that it names is replaced.
    write : function
        Writes the whole content to the open file. If it raises, no new file is left behind.

    Raises
    ------
    ConfigError
        See `check_target`.
    OSError
        The file cannot be written: the disk is full, for example.
    """
    path = check_target(path)
    try:
        with replacing(_follow(path)) as file:
            write(file)
    except OSError as error:
        # Named by the user's path, not by the temporary one.
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a new file that takes the place of `path` at the end of the block, unless the block fails."""
    temporary = _new_path(path.parent, ".clbvh-", ".tmp")
    try:
        with temporary.open("x+b") as file:
            yield file
        if path.is_file():
            temporary.chmod(stat.S_IMODE(path.stat().st_mode))
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
        _unfinished.discard(temporary)


@contextmanager
def temporary_folder(parent: Path, prefix: str) -> Iterator[Path]:
    """Make a folder that only the user can enter; it is removed with its content at the end of the block."""
    folder = _new_path(parent, prefix)
    try:
        folder.mkdir(mode=0o700)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _unfinished.discard(folder)


def remove_unfinished() -> None:
    """Remove all files and folders of the two functions above: for a signal that ends the process without an error."""
    for path in list(_unfinished):
        with suppress(OSError):
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def _new_path(folder: Path, prefix: str, suffix: str = "") -> Path:
    """Return a path that no other process uses, and note that it is to be removed."""
    path = folder / f"{prefix}{os.urandom(_NAME_BYTES).hex()}{suffix}"
    _unfinished.add(path)
    return path


def _follow(path: Path) -> Path:
    """Return the file that a path names when links are followed; it need not exist."""
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:
        raise ConfigError(f"{path}: this link leads nowhere: {error}") from error
