"""Compiled functions, and the folder of their machine code.

numba caches machine code per function and checks only the function's own file for changes. Changes of a function that
was inlined from another file, or of a constant from there, would go unnoticed, and old code would run. Therefore the
folder is named after a digest of all source files that compiled functions can depend on: any change of them starts a
new folder.

The time of compiling goes to `code_times`.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import string
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

from .fresh_stack import import_on_fresh_stack

# The statements below import numba, and do so on the stack of their callers.
import_on_fresh_stack("numba")

# ruff: noqa: E402
import numba
from numba import types
from numba.core import event

from . import unfinished
from .cache_folder import find_cache, is_writable, say_unusable
from .code_times import CompilingCode
from .machine_code_cache import MachineCodeCache
from .orphans import remove_orphans

# Typed as Any: numba creates the names of its settings at run time.
_settings: Any = numba.config
_njit: Any = numba.njit

# Held while a setting of numba's differs from that of other packages: threads may import modules at the same time.
_decorating = threading.Lock()

_PACKAGE = Path(__file__).resolve().parents[1]

# Functions of all modules by their identity, in the order of import.
_dispatchers: dict[int, Any] = {}

# Rooms without compiled functions, which a test checks; after edits of them the machine code is still valid.
INTERPRETED_ROOMS = ("cli", "device", "rendering", "warmup")

_DIGITS = 16

# Folders of older sources are removed when they have not been used for this long.
_KEPT_DAYS = 30
_SECONDS_PER_DAY = 86_400


def compiled(
    function: Callable[..., Any] | None = None, *, error_model: str = "python", is_inlined: bool = False
) -> Any:
    """Compile a function with numba on its first call; it runs without the GIL.

    Parameters
    ----------
    function : function
        None if the decorator has arguments.
    error_model : str
        ``"numpy"``: a division by zero gives an infinity or NaN, as on the device, instead of an error.
    is_inlined : bool
        Whether calls by other compiled functions become copies of its code, whatever its length: a call saves the
        vector registers of the caller.
    """
    if function is None:
        return lambda decorated: compiled(decorated, error_model=error_model, is_inlined=is_inlined)
    dispatcher = _njit(nogil=True, error_model=error_model, forceinline=is_inlined)(function)
    dispatcher.get_call_template = partial(_find_general_version, dispatcher.get_call_template)
    _dispatchers[id(dispatcher)] = dispatcher
    if (folder := find_compiled_cache()) is not None:
        # numba reads the setting when it gives a function its cache. It is restored for other packages.
        with _decorating:
            others = _settings.CACHE_DIR
            _settings.CACHE_DIR = str(folder)
            try:
                dispatcher._cache = MachineCodeCache(function)
            finally:
                _settings.CACHE_DIR = others
    return dispatcher


def list_compiled() -> list[Any]:
    """Return the functions that are compiled, of all modules imported so far."""
    return list(_dispatchers.values())


def _find_general_version(find: Callable[..., Any], arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
    """Make all calls from other compiled functions share one version for each list of types.

    numba would compile another version for each literal number in a call, such as ``f(x, 3)``. LLVM still knows the
    number where it inlines the function.
    """
    return find(
        tuple(types.unliteral(argument) for argument in arguments),
        {name: types.unliteral(argument) for name, argument in named.items()},
    )


class _CompilationListener(event.Listener):
    """Times each compilation of a function of this package, including the functions that it calls."""

    def on_start(self, event: Any) -> None:
        if _is_ours(event):
            _COMPILING.__enter__()

    def on_end(self, event: Any) -> None:
        if _is_ours(event):
            _COMPILING.__exit__(None, None, None)


_COMPILING = CompilingCode()


def _is_ours(event: Any) -> bool:
    return id(event.data["dispatcher"]) in _dispatchers


event.register("numba:compile", _CompilationListener())


@cache
def find_compiled_cache() -> Path | None:
    """Return the folder for the machine code of these sources, in `NUMBA_CACHE_DIR` or in the user's cache.

    None, said once, if it cannot be written to: then nothing is kept, not even beside the sources, where numba would
    keep it and where nothing would tell old code from new.
    """
    base = Path(_settings.CACHE_DIR) if _settings.CACHE_DIR else find_cache() / "compiled"
    folder = base / digest_sources(_PACKAGE)
    is_new = not folder.is_dir()
    if not is_writable(folder):
        say_unusable(base)
        return None
    with suppress(OSError):
        if is_new:
            _remove_unused(base)
        else:
            os.utime(folder)
            _remove_unfinished(folder)
    # Workers that are killed leave theirs.
    unfinished.add(partial(_remove_unfinished, folder))
    return folder


def _remove_unfinished(folder: Path) -> None:
    """Remove what killed processes left: each file of sources has its own folder in there."""
    for inner in folder.iterdir():
        remove_orphans(inner)


def digest_sources(package: Path) -> str:
    """Return a digest of all source files of a package but those of `INTERPRETED_ROOMS`."""
    # Every process does this before its first compiled function: `os.walk` takes 4 ms where `Path.rglob` takes 9.
    paths: list[str] = []
    for folder, inner_folders, files in os.walk(package):
        if folder == str(package):
            inner_folders[:] = [name for name in inner_folders if name not in INTERPRETED_ROOMS]
        paths += [os.path.join(folder, name) for name in files if name.endswith(".py")]  # noqa: PTH118 - see above
    digest = hashlib.sha256()
    for path in sorted(paths):
        with open(path, "rb", buffering=0) as file:  # noqa: PTH123 - see above
            digest.update(f"{path[len(str(package)) :]}\0".encode() + file.read() + b"\0")
    return digest.hexdigest()[:_DIGITS]


def _remove_unused(base: Path) -> None:
    """Remove the folders of old sources that have not been used for a while."""
    limit = time.time() - _KEPT_DAYS * _SECONDS_PER_DAY
    for folder in base.iterdir() if base.is_dir() else ():
        # In numba's own folder there may be other packages' folders.
        is_ours = len(folder.name) == _DIGITS and set(folder.name) <= set(string.hexdigits)
        if is_ours and folder.is_dir() and folder.stat().st_mtime < limit:
            shutil.rmtree(folder, ignore_errors=True)
