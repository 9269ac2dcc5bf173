"""Files that are complete or absent: written under a temporary name, then renamed."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from ..errors import ConfigError


def check_target(path: Path) -> None:
    """Raise `ConfigError` unless a file can have this path; for checks before the work begins."""
    if "\0" in str(path):
        raise ConfigError(f"{str(path)!r}: this is not the path of a file")
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise ConfigError(f"{path}: this is a folder, not a file")


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file so that its name never refers to an incomplete one.

    Parameters
    ----------
    path : Path
        A file of this name is replaced once the new one is complete.
    write : function
        Writes the whole content to the open file. If it raises, no new file is left behind.
    """
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            write(file)
        # A temporary file is private; the new one gets the permissions of any other new file.
        mask = os.umask(0)
        os.umask(mask)
        Path(name).chmod(0o666 & ~mask)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
