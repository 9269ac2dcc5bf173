"""The user's folder for files that can be made or fetched again: meshes, trees, measured settings."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_dir

CACHE_VARIABLE = "CLBVH_CACHE"


def find_cache() -> Path:
    """Return `CLBVH_CACHE`, or the system's folder for caches; it need not exist yet."""
    if folder := os.environ.get(CACHE_VARIABLE):
        return Path(folder)
    return Path(user_cache_dir("clbvh"))
