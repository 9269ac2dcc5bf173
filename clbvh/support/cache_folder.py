"""The user's folder for files that can be made or fetched again: meshes, trees, measured settings."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_dir

from .say_once import say_once

CACHE_VARIABLE = "CLBVH_CACHE"


def find_cache() -> Path:
    """Return `CLBVH_CACHE`, or the system's folder for caches; it need not exist yet."""
    if folder := os.environ.get(CACHE_VARIABLE):
        return Path(folder)
    return Path(user_cache_dir("clbvh"))


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
