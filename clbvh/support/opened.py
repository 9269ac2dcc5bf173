"""Tracers and renderers that arrive in a process again and again: opened once for each content, and kept open."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Hashable
from types import SimpleNamespace
from typing import Any, TypeVar

from .forks import make_lock

_Thing = TypeVar("_Thing")

# Things that a process keeps open; two serve tasks of two scenes by turns.
_MOST_KEPT = 2

_kept: dict[Hashable, Any] = {}  # the latest used last
_lock = make_lock()


def open_once(key: Hashable, open_anew: Callable[[], _Thing]) -> _Thing:
    """Return the thing of a key, opened unless this process keeps it; other threads wait meanwhile.

    The two that were asked for last are kept. An older one is forgotten, but not closed: whoever still has it may use
    it.
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
