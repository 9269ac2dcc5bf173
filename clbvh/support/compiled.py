"""Compiled functions, and the files of their machine code.

numba caches machine code per function and checks only the function's own file for changes. Changes of a function that
was inlined from another file, or of a constant from there, would go unnoticed, and old code would run. Therefore the
folder is named after a digest of all source files that compiled functions can depend on: any change of them starts a
new folder.

With numba's own files, a damaged one stops every later run, a full disk stops this one, and two processes that compile
a function at once can write both versions into one file. Here each signature of a function has one file, which begins
with a digest. What cannot be read is compiled again and replaced, and what cannot be written is not kept.

numba also gets ready to compile before it loads anything: it imports and registers all that it can compile, and the
modules of all functions that were inlined. That is 0.35 s of processor time on a 2-core x86-64 server with scipy, 0.25
s without it, more than half of what numba costs a short process. Here loading prepares the runtime of machine code and
nothing else; numba gets ready by itself if something must be compiled after all.
"""

from __future__ import annotations

import glob
import hashlib
import io
import os
import pickle
import shutil
import string
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import numba
from llvmlite.binding.ffi import lib
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.environment import Environment, lookup_environment
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

from .compiled_parts import Calls, PartCompiler
from .files import replacing
from .folders import find_cache, is_writable, say_unusable
from .forks import make_lock, wait_before_fork
from .say_once import say_compiling, say_once

# Typed as Any: numba creates the names of its settings at run time.
_settings: Any = numba.config
_njit: Any = numba.njit

# Held while a setting of numba's differs from that of other packages: threads may import modules at the same time.
_decorating = make_lock()

_PACKAGE = Path(__file__).resolve().parents[1]

# Functions of all modules by their identity, in the order of import.
_dispatchers: dict[int, Any] = {}

# Rooms without compiled functions, which a test checks; after edits of them the machine code is still valid.
INTERPRETED_ROOMS = ("cli", "device", "rendering")

# Hexadecimal digits of the sources' digest.
_DIGITS = 16

_DIGEST_BYTES = 16

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
    # Without the form that C could call, which nobody does: it would take 6 % of the time to compile.
    options = {"nogil": True, "error_model": error_model, "forceinline": is_inlined, "no_cfunc_wrapper": True}
    dispatcher = _njit(**options)(function)
    # What Python calls and what other compiled functions call are versions of their own.
    make_part = _njit(**options, no_cpython_wrapper=True, pipeline_class=PartCompiler)
    dispatcher.calls = calls = Calls(dispatcher, partial(make_part, function))
    dispatcher.get_call_template, dispatcher.get_overload = calls.get_call_template, calls.get_overload
    _dispatchers[id(dispatcher)] = dispatcher
    if (folder := find_compiled_cache()) is not None:
        # numba reads the setting when it gives a function its cache. It is restored for other packages.
        with _decorating:
            others = _settings.CACHE_DIR
            _settings.CACHE_DIR = str(folder)
            try:
                dispatcher._cache = _MachineCodeCache(function)
            finally:
                _settings.CACHE_DIR = others
    return dispatcher


# A fork waits until numba compiles nothing: the compiler's state would be half written in the child.
for _lock in (lib._lock._lock, global_compiler_lock._lock):
    wait_before_fork(_lock)


class _CompilationListener(event.Listener):
    """Tells the user when a function of this package is compiled."""

    def on_start(self, event: Any) -> None:
        if id(event.data["dispatcher"]) in _dispatchers:
            say_compiling()

    def on_end(self, event: Any) -> None:
        pass


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
    return folder


def digest_sources(folder: Path, files: str = "**/*.py", without: Sequence[str] = INTERPRETED_ROOMS) -> str:
    """Return a digest of the files below a folder, without some rooms directly in it: by default of Python's sources.

    Every process does this before its first compiled function; `Path.rglob` would take twice the time.
    """
    digest = hashlib.sha256()
    for path in sorted(glob.iglob(files, root_dir=folder, recursive=True)):  # noqa: PTH207 - see above
        if path.partition(os.sep)[0] not in without:
            digest.update(f"{path}\0".encode() + (folder / path).read_bytes() + b"\0")
    return digest.hexdigest()[:_DIGITS]


def _remove_unused(base: Path) -> None:
    """Remove the folders of old sources that have not been used for a while."""
    limit = time.time() - _KEPT_DAYS * _SECONDS_PER_DAY
    for folder in base.iterdir() if base.is_dir() else ():
        # In numba's own folder there may be other packages' folders.
        is_ours = len(folder.name) == _DIGITS and set(folder.name) <= set(string.hexdigits)
        if is_ours and folder.is_dir() and folder.stat().st_mtime < limit:
            shutil.rmtree(folder, ignore_errors=True)


class _MachineCodeCache(FunctionCache):
    """numba's cache of a function; its public methods are `load_overload` and `save_overload`."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _CodeFiles(Path(self.cache_path), self._impl.filename_base)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return compiled code for a signature, None where there is none that can be used."""
        try:
            # The parent's method without its `target_context.refresh()`, which compilation calls, too.
            rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)
        except FileNotFoundError:
            return None
        except Exception as error:  # damaged content can raise anything
            say_once(f"machine code in the cache {self.cache_path} cannot be used and is compiled again ({error!r})")
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep compiled code."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            say_once(f"machine code cannot be kept in the cache {self.cache_path}: {error.strerror or error}")


class _CodeFiles:
    """The files of one function's machine code, in the place of numba's index and data files."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder, self._name = folder, name

    def save(self, key: Any, data: Any) -> None:
        content = dumps(data)
        with replacing(self._path(key)) as file:
            file.write(_digest(content) + content)

    def load(self, key: Any) -> Any:
        path = self._path(key)
        content = path.read_bytes()
        if content[:_DIGEST_BYTES] != _digest(content[_DIGEST_BYTES:]):
            raise ValueError(f"{path.name} is damaged")
        return _CodeUnpickler(io.BytesIO(content[_DIGEST_BYTES:])).load()

    def _path(self, key: Any) -> Path:
        """Return the file of a signature, a processor and a version of numba."""
        return self._folder / f"{self._name}.{_digest(repr((numba.__version__, key)).encode()).hex()}.nbc"


class _CodeUnpickler(pickle.Unpickler):
    """Reads machine code without importing the modules of functions that were inlined into it."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("numba.core.environment", "_rebuild_env"):
            return _rebuild_environment
        return super().find_class(module, name)


def _rebuild_environment(module: str, constants: list[Any], name: str) -> Environment:
    """Return the Python objects that machine code of one function refers to: its constants.

    Only functions in object mode look up names of the module, and here there are none.
    """
    environment = lookup_environment(name)
    if environment is None:
        imported = sys.modules.get(module)
        # The name alone is enough to store the environment again.
        environment = Environment({"__name__": module} if imported is None else vars(imported))
        environment.consts[:] = constants
        environment.env_name = name
        Environment._memo[name] = environment
    return environment


def _digest(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES).digest()
