"""Unique names: those that a user chooses, and those that are derived from a file's."""

from __future__ import annotations

from pathlib import Path

from ..errors import SceneError

_MAX_SHOWN = 60  # characters of a wrong value in a message


class UniqueNames:
    """The names of all things of one kind, and their ids, which count up from 0.

    Parameters
    ----------
    kind : str
        For messages, with its article: ``"a geometry"``.
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._ids: dict[str, int] = {}
        self._next_number: dict[str, int] = {}

    def __len__(self) -> int:
        return len(self._ids)

    def find(self, name: str) -> int | None:
        """Return the id of a name."""
        return self._ids.get(name)

    def check(self, name: object) -> None:
        """Raise `SceneError` unless a name that a user chose is a text that nothing else has."""
        if not is_name(name):
            raise SceneError(f"the name of {self.kind} must be a text that is not empty, not {_show(name)}")
        if name in self._ids:
            raise SceneError(f"the scene has {self.kind} with the name {_show(name)} already: choose another one")

    def add(self, name: str) -> str:
        """Add a name that `check` has accepted."""
        self._ids[name] = len(self._ids)
        return name

    def add_numbered(self, wish: str) -> str:
        """Add a name and return it: the wish itself, or with the first free number from 2 behind it."""
        name = wish
        number = self._next_number.get(wish, 2)
        while name in self._ids:
            name = f"{wish} {number}"
            number += 1
        self._next_number[wish] = number
        return self.add(name)

    def copy(self) -> UniqueNames:
        """Return names that grow apart from these."""
        names = UniqueNames(self.kind)
        names._ids, names._next_number = self._ids.copy(), self._next_number.copy()
        return names


def is_name(value: object) -> bool:
    """Return whether a value is a name: a text that is not empty and can be written into a file."""
    return isinstance(value, str) and bool(value.strip()) and value == clean_name(value)


def clean_name(text: str) -> str:
    """Return a file's name without halves of characters, which JSON allows and UTF-8 does not."""
    return text.encode("utf-8", "replace").decode()


def name_of_file(path: str) -> str:
    """Return the name of what a file holds: the file's without its suffix."""
    return Path(path).stem or path


def _show(value: object) -> str:
    return repr(value)[:_MAX_SHOWN]
