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

# The name of a socket has at most 107 bytes, and those of this folder and of a socket in it take 40 of them. Where the
# user's folder for temporary files has a longer name, the system's is taken.
_LONGEST_PARENT = 107 - 40
_SHORT_PARENT = Path("/tmp")

_making = threading.Lock()
# The folder of this process, by its id: a forked child makes its own.
_folders: dict[int, Path] = {}


def get_run_folder() -> Path:
    """Return the folder, which only this user can enter; its name leaves room for that of a socket.

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
        parent = _find_parent()
    except OSError:
        return
    remove_orphan_folders(parent, _prefix())


def _find_parent() -> Path:
    parent = Path(tempfile.gettempdir())
    is_long = len(os.fsencode(parent)) > _LONGEST_PARENT
    return _SHORT_PARENT if is_long and os.access(_SHORT_PARENT, os.W_OK | os.X_OK) else parent


def _prefix() -> str:
    user = os.getuid() if hasattr(os, "getuid") else ""
    return f"clbvh-{user}-"


def _make() -> Path:
    folder = TemporaryFolder(_find_parent(), _prefix())
    atexit.register(folder.close)
    return folder.path
