"""What a process has opened by its content, and keeps open: tracers and renderers that arrive again and again."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Hashable
from types import SimpleNamespace
from typing import Any, TypeVar

from .forks import make_lock

_Thing = TypeVar("_Thing")

# Kept in a process: a second one serves tasks of two scenes by turns.
_MOST_KEPT = 2

_kept: dict[Hashable, Any] = {}  # the latest used last
_lock = make_lock()


def open_once(key: Hashable, open_anew: Callable[[], _Thing]) -> _Thing:
    """Return the thing of a key, opened unless this process keeps it; other threads wait meanwhile.

    Of more than two, the one that was not asked for the longest time is forgotten. It is not closed: whoever still has
    it may use it.
    """
    with _lock:
        thing = _kept.pop(key, None)
        while len(_kept) >= _MOST_KEPT:
            del _kept[next(iter(_kept))]
        _kept[key] = open_anew() if thing is None else thing
        return _kept[key]


def digest_of(thing: object) -> str:
    """Return the SHA-256 of the pickle of a thing, which is not held in memory."""
    digest = hashlib.sha256()
    pickle.Pickler(SimpleNamespace(write=digest.update), pickle.HIGHEST_PROTOCOL).dump(thing)
    return digest.hexdigest()
