"""The folder for temporary files of this process: made when first asked for, removed when the process ends.

It holds the sockets of worker processes and, where the user has no cache, a driver's files. A process that is killed
leaves it behind; the next one that needs such a folder removes it.
"""

from __future__ import annotations

import atexit
import os
import tempfile
import threading
from pathlib import Path

from .orphans import remove_orphan_folders
from .temporary_folder import TemporaryFolder

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
    folder = TemporaryFolder(Path(tempfile.gettempdir()), _prefix())
    atexit.register(folder.close)
    return folder.path
