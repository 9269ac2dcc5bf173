"""Folders in which drivers and PyOpenCL keep files, where the user's own cannot be used.

PoCL compiles in its cache and offers no device without one, so a machine with a read-only home would have none. The
environment is read when a driver is loaded: `prepare` must run before `pyopencl` is imported.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

from ..support.cache_folder import find_cache, is_writable, say_unusable
from ..support.run_folder import get_run_folder, remove_old_run_folders

POCL_VARIABLE = "POCL_CACHE_DIR"


@cache
def prepare() -> None:
    """Give PoCL a folder if its own cannot be written to: in clbvh's cache, or else one that lives with this process.

    Without any folder nothing is changed, and the driver says what it lacks.
    """
    remove_old_run_folders()
    if os.environ.get(POCL_VARIABLE) == "":
        del os.environ[POCL_VARIABLE]  # PoCL would take it for a name
    # A folder that the user has named is the user's business, also where it is wrong: `clbvh doctor` finds that.
    users_cache = _find_users_cache()
    if os.environ.get(POCL_VARIABLE) or (users_cache is not None and is_writable(users_cache / "pocl")):
        return
    folder = find_cache()
    try:
        if not is_writable(folder):
            say_unusable(folder)
            folder = get_run_folder()
            # PyOpenCL keeps launchers of kernels there, and warns where it cannot.
            os.environ["XDG_CACHE_HOME"] = str(folder)
        folder /= "pocl"
        folder.mkdir(exist_ok=True)
    except OSError:
        return
    os.environ[POCL_VARIABLE] = str(folder)


def _find_users_cache() -> Path | None:
    """Return the folder that PoCL takes for the user's cache; None without a home."""
    if folder := os.environ.get("XDG_CACHE_HOME"):
        return Path(folder)
    home = os.environ.get("HOME")
    return Path(home) / ".cache" if home else None
