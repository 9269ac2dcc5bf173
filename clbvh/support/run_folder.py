"""The folder for temporary files of this process: made when first asked for, removed when the process ends.

It holds the sockets of worker processes and, where the user has no cache, a driver's files. A process that is killed
leaves it behind; the next one that needs such a folder removes it.
"""

from __future__ import annotations

import atexit
import os
import tempfile
import threading
from functools import partial
from pathlib import Path

from . import unfinished
from .orphans import lock, random_name, remove_orphan_folders, remove_tree

_making = threading.Lock()
# The folder of this process, by its id: a forked child makes its own.
_folders: dict[int, Path] = {}


def get_run_folder() -> Path:
    """Return the folder, which only this user can enter.

    Raises
    ------
    OSError
        There is no folder for temporary files, or it cannot be written to.
    """
    with _making:
        process = os.getpid()
        if process not in _folders:
            _folders[process] = _make()
        return _folders[process]


def remove_old_run_folders() -> None:
    """Remove what killed processes of this user left; without a folder for temporary files there is nothing."""
    try:
        parent = tempfile.gettempdir()
    except OSError:
        return
    remove_orphan_folders(Path(parent), _prefix())


def _prefix() -> str:
    user = os.getuid() if hasattr(os, "getuid") else ""
    return f"clbvh-{user}-"


def _make() -> Path:
    parent = Path(tempfile.gettempdir())
    remove_orphan_folders(parent, _prefix())
    while True:
        folder = parent / random_name(_prefix())
        ticket = unfinished.add(partial(remove_tree, folder))
        try:
            folder.mkdir(mode=0o700)
            # Open, and so locked, until the process ends.
            descriptor = os.open(folder, os.O_RDONLY) if hasattr(os, "O_DIRECTORY") else None
        except BaseException:
            remove_tree(folder)
            unfinished.discard(ticket)
            raise
        if descriptor is None or lock(descriptor):
            atexit.register(_remove, folder, descriptor, os.getpid())
            return folder
        os.close(descriptor)
        unfinished.discard(ticket)


def _remove(folder: Path, descriptor: int | None, owner: int) -> None:
    if os.getpid() == owner:
        if descriptor is not None:
            os.close(descriptor)  # the walk through the folder needs a handle, and none may be left
        remove_tree(folder)
