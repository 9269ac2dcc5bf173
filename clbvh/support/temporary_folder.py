"""A temporary folder that goes with its owner: closed, interrupted or killed."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

from . import unfinished
from .context_manager import ContextManager
from .orphans import lock, random_name, remove_orphan_folders, remove_tree

# Only the user can enter.
_MODE = 0o700


class TemporaryFolder(ContextManager):
    """A new folder, removed with its content when it is closed.

    Folders with this prefix that killed processes left are removed first.

    Parameters
    ----------
    parent : Path
    prefix : str

    Raises
    ------
    OSError
        It cannot be created.

    Attributes
    ----------
    path : Path
    """

    def __init__(self, parent: Path, prefix: str) -> None:
        remove_orphan_folders(parent, prefix)
        self._owner = os.getpid()
        while True:
            self.path = parent / random_name(prefix)
            self._ticket = unfinished.add(partial(remove_tree, self.path))
            self._descriptor: int | None = None
            try:
                self.path.mkdir(mode=_MODE)
                # Open, and so locked, until the folder is closed or the process ends.
                if hasattr(os, "O_DIRECTORY"):
                    self._descriptor = os.open(self.path, os.O_RDONLY)
            except BaseException:
                self.close()
                raise
            if self._descriptor is None or lock(self._descriptor):
                return
            self.close()

    def close(self) -> None:
        """Remove the folder. Closing twice is allowed; a forked child leaves it to its owner."""
        if os.getpid() != self._owner:
            return
        if self._descriptor is not None:
            os.close(self._descriptor)  # the walk through the folder needs a handle, and none may be left
            self._descriptor = None
        remove_tree(self.path)
        unfinished.discard(self._ticket)
