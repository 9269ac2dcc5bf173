"""The user's cache, and the folders that ship with clbvh.

The cache holds files that can be made or fetched again: meshes and trees. A wheel carries kernel sources and scenes
inside the package; a source checkout and an editable install have them one folder up.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from platformdirs import user_cache_dir

from ..errors import InternalError
from .say_once import say_once

CACHE_VARIABLE = "CLBVH_CACHE"


_temporary: list[tempfile.TemporaryDirectory[str]] = []  # one item at most, which is removed when this process ends


def find_cache() -> Path:
    """Return `CLBVH_CACHE`, or the system's folder for caches; it need not exist yet.

    For a user without a home, which is said once, it is a temporary folder, and `CLBVH_CACHE` from then on.
    """
    if folder := os.environ.get(CACHE_VARIABLE):
        return Path(folder)
    if (users := find_users_folder(user_cache_dir)) is not None:
        return users
    say_once(
        "this user has no home folder, so trees and settings are kept until the program ends: "
        f"set {CACHE_VARIABLE} to a folder that can be written to",
        about="unusable cache",
    )
    try:
        _temporary.append(tempfile.TemporaryDirectory(prefix="clbvh-"))
    except OSError:
        return Path(os.devnull) / "clbvh"  # where nothing can be written, which callers notice
    os.environ[CACHE_VARIABLE] = _temporary[0].name
    return Path(_temporary[0].name)


def find_users_folder(find: Callable[..., str]) -> Path | None:
    """Return a folder of the user's by a function of platformdirs; None for a user without a home, as in containers."""
    try:
        folder = Path(find("clbvh", appauthor=False))
    except RuntimeError:
        return None
    return folder if folder.is_absolute() else None  # platformdirs 4.3 and older return a `~`


def is_writable(folder: Path) -> bool:
    """Return whether files can be written into a folder, which is created where it does not exist."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


def say_unusable(folder: Path) -> None:
    """Tell the user that nothing can be kept in a cache: once, for the first of several that share a cause."""
    say_once(
        f"nothing can be kept in the cache {folder}, so every run compiles anew: set {CACHE_VARIABLE} to a folder that "
        "can be written to",
        about="unusable cache",
    )


_PACKAGE = Path(__file__).resolve().parents[1]


def find_folder(name: str) -> Path:
    """Return the shipped folder `name`: the packaged copy first, then the one of the source checkout.

    Parameters
    ----------
    name : str
        ``"cl"`` or ``"scenes"``.

    Raises
    ------
    InternalError
        Neither exists: the installation is broken.
    """
    candidates = (_PACKAGE / name, _PACKAGE.parent / name)
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    raise InternalError(
        f"the shipped folder '{name}' is in neither {candidates[0]} nor {candidates[1]}: reinstall clbvh"
    )
