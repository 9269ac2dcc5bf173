"""The files in which numba keeps the machine code of one function, made safe against faults.

With numba's own, an interrupted process leaves a temporary file behind, a damaged file stops every later run, a full
disk stops this one, and two processes that compile different signatures of a function at once can write both into one
file. Here a file carries a digest, is named by its signature, and is written like all others of clbvh. What cannot be
read is compiled again and replaced, and what cannot be written is not kept; both are said once.

numba's own also gets ready to compile before it loads anything: it imports and registers all that it can compile, and
the modules of all functions that were inlined. That is 0.35 s of processor time on a 2-core x86-64 server with scipy,
0.25 s without it, more than half of what numba costs a short process. Here loading prepares the runtime of machine code
and nothing else; numba gets ready by itself if something must be compiled after all.
"""

from __future__ import annotations

import hashlib
import io
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.environment import Environment, lookup_environment
from numba.core.runtime import rtsys

from .atomic_file import replacing
from .code_times import CompilingCode, LoadingCode
from .say_once import say_once

_DIGEST_BYTES = 16

# Of the digest of a signature, in the name of its file.
_NUMBER_BYTES = 8


class MachineCodeCache(FunctionCache):
    """numba's cache of a function; its public methods are `load_overload` and `save_overload`."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        # The class differs in how files are written and checked.
        self._cache_file.__class__ = _CheckedFiles

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return compiled code for a signature, None where there is none that can be used."""
        with LoadingCode() as loading:
            try:
                # The parent's method without its `target_context.refresh()`, which compilation calls, too.
                rtsys.initialize(target_context)
                with self._guard_against_spurious_io_errors():
                    code = self._load_overload(sig, target_context)
            except Exception as error:  # damaged content can raise anything
                _say_unusable(self.cache_path, error)
                return None
            loading.is_loaded = code is not None
            return code

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep compiled code."""
        with CompilingCode(counts=False):
            try:
                super().save_overload(sig, data)
            except OSError as error:
                say_once(f"machine code cannot be kept in the cache {self.cache_path}: {error.strerror or error}")


class _CheckedFiles(IndexDataCacheFile):
    """numba's files of one function: an index, and one file for each signature."""

    def save(self, key: Any, data: Any) -> None:
        name = self._data_name(int.from_bytes(_digest(repr(key).encode())[:_NUMBER_BYTES], "little"))
        self._save_data(name, data)
        # After its data: an index never names a file that another process has yet to write.
        index = self._load_index()
        if index.get(key) != name:
            self._save_index(index | {key: name})

    def _load_index(self) -> dict[Any, str]:
        try:
            return super()._load_index()
        except Exception as error:  # as above
            _say_unusable(self._cache_path, error)
            return {}

    def _save_data(self, name: str, data: Any) -> None:
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(_digest(content) + content)

    def _load_data(self, name: str) -> Any:
        content = Path(self._data_path(name)).read_bytes()
        if content[:_DIGEST_BYTES] != _digest(content[_DIGEST_BYTES:]):
            raise ValueError(f"{name} is damaged")
        return _CodeUnpickler(io.BytesIO(content[_DIGEST_BYTES:])).load()

    def _open_for_write(self, filepath: str) -> Any:
        return replacing(Path(filepath))


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


def _say_unusable(folder: str, error: Exception) -> None:
    say_once(f"machine code in the cache {folder} cannot be used and is compiled again ({error!r})")


def _digest(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES).digest()
