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
        if len(arguments) != len(self.argument_names) or not all(name in arguments for name in self.argument_names):
            differing = sorted(arguments.keys() ^ set(self.argument_names))
            raise InternalError(
                f"the kernel '{self.name}' takes {', '.join(self.argument_names)}: missing or unknown are "
                f"{', '.join(differing)}"
            )
        return [arguments[name] for name in self.argument_names]
