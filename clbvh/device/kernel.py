"""A kernel of any device: its name, and the names of its arguments in the order of the declaration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ..errors import InternalError


class Kernel:
    """An entry point that takes its arguments by name, from any thread.

    Parameters
    ----------
    name : str
    argument_names : iterable of str
        In the order of the declaration.
    """

    def __init__(self, name: str, argument_names: Iterable[str]) -> None:
        self.name = name
        self.argument_names = tuple(argument_names)

    def in_order(self, arguments: Mapping[str, Any]) -> list[Any]:
        """Return arguments in the order of the declaration.

        Raises
        ------
        InternalError
            A name is missing, or the kernel has no argument of that name.
        """
        names = self.argument_names
        try:
            values = [arguments[name] for name in names]
        except KeyError:
            values = []
        if len(values) != len(arguments):
            differing = sorted(arguments.keys() ^ set(names))
            raise InternalError(
                f"the kernel '{self.name}' takes {', '.join(names)}: missing or unknown are {', '.join(differing)}"
            )
        return values
