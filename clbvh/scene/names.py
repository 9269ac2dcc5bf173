"""Names of the things in a scene: unique, and numbered where a wish is taken."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ..errors import SceneError
from .handles import shorten


class UniqueNames:
    """The names of all things of one kind, and their ids, which count up from 0.

    Parameters
    ----------
    kind : str
        For messages, with its article: ``"a geometry"``.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._ids: dict[str, int] = {}
        self._next_number: dict[str, int] = {}

    def __len__(self) -> int:
        return len(self._ids)

    def __iter__(self) -> Iterator[str]:
        return iter(self._ids)

    def find(self, name: object) -> int | None:
        """Return the id of a name."""
        return self._ids.get(name) if isinstance(name, str) else None

    def check(self, name: object) -> None:
        """Raise `SceneError` unless a name is a text that nothing else has."""
        if not _is_name(name):
            raise SceneError(f"the name of {self._kind} must be a text that is not empty, not {shorten(name)}")
        if name in self._ids:
            raise SceneError(f"the scene has {self._kind} with the name {shorten(name)} already: choose another one")

    def add(self, name: str) -> str:
        """Add a name that `check` has accepted."""
        self._ids[name] = len(self._ids)
        return name

    def add_numbered(self, wish: str) -> str:
        """Add a name and return it: the wish itself, or with the first free number from 2 behind it.

        The wish comes from a file or a mesh, so it may be anything.
        """
        name = wish = _clean(str(wish)).strip() or self._kind.split()[-1]
        number = self._next_number.get(wish, 2)
        while name in self._ids:
            name = f"{wish} {number}"
            number += 1
        self._next_number[wish] = number
        return self.add(name)

    def copy(self) -> UniqueNames:
        """Return names that grow apart from these."""
        names = UniqueNames(self._kind)
        names._ids, names._next_number = self._ids.copy(), self._next_number.copy()
        return names


def _is_name(value: object) -> bool:
    """Return whether a value is a text that is not empty and can be written into a file."""
    return isinstance(value, str) and bool(value.strip()) and value == _clean(value)


def _clean(text: str) -> str:
    """Return a text without halves of characters, which JSON allows and UTF-8 does not."""
    return text.encode("utf-8", "replace").decode()


def name_of_file(path: str) -> str:
    """Return the name of what a file holds: the file's without its suffix."""
    return Path(path).stem or path
