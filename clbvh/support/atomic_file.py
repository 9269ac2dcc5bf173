"""Files that are whole or absent: written under a temporary name, then renamed."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from .errors import ConfigError


def check_target(path: Path) -> None:
    """Raise `ConfigError` unless a file can have this path; for a check before the work begins."""
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise ConfigError(f"{path}: this is a folder, not a file")


def write_whole(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file so that no half of it is ever seen under its name.

    Parameters
    ----------
    path : Path
        A file that stands there is replaced, once the new one is complete.
    write : function
        Given the open file, writes all of it. Whatever it raises, nothing new stays.
    """
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(descriptor, "wb") as file:
            write(file)
        # A temporary file is private; this one has the rights of any other new file.
        mask = os.umask(0)
        os.umask(mask)
        Path(name).chmod(0o666 & ~mask)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
