"""Compiled functions, and the folder of their machine code.

numba caches machine code per function and checks only the function's own file for changes. Changes of a function that
was inlined from another file, or of a constant from there, would go unnoticed, and old code would run. Therefore the
folder is named after a digest of all source files that compiled functions can depend on: any change of them starts a
new folder.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba

from .cache_folder import find_cache

# Typed as Any: numba creates the names of its settings at run time.
_settings: Any = numba.config
_njit: Any = numba.njit

# Held while a setting of numba's differs from that of other packages: threads may import modules at the same time.
_decorating = threading.Lock()

_PACKAGE = Path(__file__).resolve().parents[1]

# Rooms without compiled functions; an edit of them keeps the machine code. A test holds them to it.
INTERPRETED_ROOMS = ("cli", "device", "integrations", "rendering")

_DIGITS = 16

# Folders of older sources are removed when they have not been used for this long.
_KEPT_DAYS = 30
_SECONDS_PER_DAY = 86_400


def compiled(function: Callable[..., Any] | None = None, *, error_model: str = "python") -> Any:
    """Compile a function with numba on its first call; it runs without the GIL.

    Parameters
    ----------
    function : function
        None if the decorator has arguments.
    error_model : str
        ``"numpy"``: a division by zero gives an infinity or NaN, as on the device, instead of an error.
    """
    if function is None:
        return lambda decorated: compiled(decorated, error_model=error_model)
    # numba reads the setting when it decorates a function. It is restored for other packages.
    with _decorating:
        others = _settings.CACHE_DIR
        _settings.CACHE_DIR = str(find_compiled_cache())
        try:
            return _njit(cache=True, nogil=True, error_model=error_model)(function)
        finally:
            _settings.CACHE_DIR = others


@cache
def find_compiled_cache() -> Path:
    """Return the folder for the machine code of these sources, in `NUMBA_CACHE_DIR` or in the user's cache."""
    base = Path(_settings.CACHE_DIR) if _settings.CACHE_DIR else find_cache() / "compiled"
    folder = base / digest_sources(_PACKAGE)
    # If the folder cannot be written to, numba falls back to other folders.
    with suppress(OSError):
        if folder.is_dir():
            os.utime(folder)
        else:
            _remove_unused(base)
            folder.mkdir(parents=True, exist_ok=True)
    return folder


def digest_sources(package: Path) -> str:
    """Return a digest of all source files of a package but those of `INTERPRETED_ROOMS`."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package)
        if name.parts[0] not in INTERPRETED_ROOMS:
            digest.update(f"{name}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()[:_DIGITS]


def _remove_unused(base: Path) -> None:
    """Remove the folders of old sources that have not been used for a while."""
    limit = time.time() - _KEPT_DAYS * _SECONDS_PER_DAY
    for folder in base.iterdir() if base.is_dir() else ():
        if len(folder.name) == _DIGITS and folder.is_dir() and folder.stat().st_mtime < limit:
            shutil.rmtree(folder, ignore_errors=True)
