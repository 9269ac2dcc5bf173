"""Names of the things in a scene: unique, with a number where the wanted name is taken."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from ..errors import SceneError
from .handles import shorten

_Thing = TypeVar("_Thing")


class Named(dict[str, _Thing]):
    """The things of one kind by their names, in the order in which they were added.

    Parameters
    ----------
    kind : str
        For messages, with its article: ``"a geometry"``.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._next_number: dict[str, int] = {}

    def check(self, name: object) -> str:
        """Return a name; raise `SceneError` unless it is a text that nothing else has, and that is not empty."""
        if not isinstance(name, str) or not name.strip() or name != _clean(name):
            raise SceneError(f"the name of {self._kind} must be a text that is not empty, not {shorten(name)}")
        if name in self:
            raise SceneError(f"the scene has {self._kind} with the name {shorten(name)} already: choose another one")
        return name

    def find_free(self, wish: str) -> str:
        """Return a name that is not taken: the wish itself, or with the first free number from 2 behind it.

        The wish comes from a file or a mesh, so it may be anything.
        """
        name = wish = _clean(str(wish)).strip() or self._kind.split()[-1]
        number = self._next_number.get(wish, 2)
        while name in self:
            name = f"{wish} {number}"
            number += 1
        self._next_number[wish] = number
        return name


def _clean(text: str) -> str:
    """Return a text without halves of characters, which JSON allows and UTF-8 does not."""
    return text.encode("utf-8", "replace").decode()


def name_of_file(path: str) -> str:
    """Return the name of what a file holds: the file's without its suffix."""
    return Path(path).stem or path
