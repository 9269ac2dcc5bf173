"""Temporary files and folders of processes that are gone.

The owner of a temporary file or folder holds a lock on it (`flock`). The system releases the lock when the process
ends, however it ends; so what is named like a temporary file, but is not locked, has no owner and can be removed. This
holds in containers that share a folder and where process ids are used again. Without `flock` nothing is removed.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# Random bytes in a name.
_NAME_BYTES = 8

FILE_PREFIX, FILE_SUFFIX = ".clbvh-", ".tmp"


def random_name(prefix: str, suffix: str = "") -> str:
    """Return a name that no other file has."""
    return prefix + os.urandom(_NAME_BYTES).hex() + suffix


def lock(descriptor: int) -> bool:
    """Lock an open file or folder for as long as it stays open; return whether it still has a name and is ours."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False  # another process has taken it for an orphan, and removes it
    except OSError:
        return True  # a file system without locks; nobody else can lock it either
    return os.fstat(descriptor).st_nlink > 0


def remove_orphans(folder: Path) -> None:
    """Remove the temporary files in a folder whose owners are gone; problems are ignored."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith(FILE_PREFIX) and entry.name.endswith(FILE_SUFFIX):
                _remove_if_orphan(Path(entry.path), stat.S_ISREG)


def remove_orphan_folders(folder: Path, prefix: str) -> None:
    """Remove the folders in a folder that have this prefix and whose owners are gone; problems are ignored."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith(prefix):
                _remove_if_orphan(Path(entry.path), stat.S_ISDIR)


def remove_tree(folder: Path) -> None:
    """Remove a folder and its content; problems are ignored. `shutil.rmtree` would be a slow import."""
    for path, folders, files in os.walk(folder, topdown=False):
        for name in files:
            with suppress(OSError):
                os.unlink(os.path.join(path, name))  # noqa: PTH108, PTH118 - bytes may not decode
        for name in folders:
            child = os.path.join(path, name)  # noqa: PTH118
            with suppress(OSError):
                os.unlink(child) if os.path.islink(child) else os.rmdir(child)  # noqa: PTH106, PTH108, PTH114
    with suppress(OSError):
        folder.rmdir()


def _remove_if_orphan(path: Path, is_kind: Callable[[int], bool]) -> None:
    if fcntl is None:
        return
    # Not through a link, and without waiting for the other end of a FIFO.
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
    with suppress(OSError):
        descriptor = os.open(path, flags)
        try:
            status = os.fstat(descriptor)
            if is_kind(status.st_mode) and status.st_uid == os.geteuid():
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                remove_tree(path) if stat.S_ISDIR(status.st_mode) else path.unlink()
        finally:
            os.close(descriptor)
