"""The base of objects that must be closed: they can be used in a `with` block."""

from __future__ import annotations

from types import TracebackType
from typing import Self


class ContextManager:
    """A context manager that calls `close` at the end of its block, also after an error."""

    def close(self) -> None:
        """Release everything held. Closing twice is allowed."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
