"""The base of objects that must be closed: they can be used in a `with` block."""

from __future__ import annotations

from typing import Self


class ContextManager:
    """A context manager that calls `close` at the end of its block, also after an error."""

    def close(self) -> None:
        """Release everything held. Closing twice is allowed."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
