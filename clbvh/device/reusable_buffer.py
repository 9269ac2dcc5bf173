"""A buffer that stays on the device between launches, as large as the largest of them wanted it."""

from __future__ import annotations

from typing import Any

from .session import DeviceSession


class KeptBuffer:
    """At most one buffer of a session.

    Parameters
    ----------
    session : DeviceSession
    for_mapping : bool
        See `DeviceSession.allocate`.
    """

    def __init__(self, session: DeviceSession, *, for_mapping: bool = False) -> None:
        self._session = session
        self._for_mapping = for_mapping
        self._buffer: Any = None
        self._size = 0

    def take(self, size: int) -> Any:
        """Return the buffer, with room for at least `size` bytes; a larger one takes its place where needed."""
        if self._buffer is None or size > self._size:
            self.release()
            self._buffer = self._session.allocate(size, for_mapping=self._for_mapping)
            self._size = size
        return self._buffer

    def release(self) -> None:
        """Give the buffer back; the next one is new."""
        if self._buffer is not None:
            self._session.release(self._buffer)
        self._buffer = None
