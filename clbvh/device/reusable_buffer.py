"""A buffer that stays on the device from launch to launch, and grows to the largest size asked for."""

from __future__ import annotations

from typing import Any

from .session import DeviceSession


class ReusableBuffer:
    """One buffer of a session, allocated when first taken.

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
        self.size = 0  # bytes; 0 without a buffer

    def take(self, size: int) -> Any:
        """Return the buffer, with room for at least `size` bytes; it is replaced by a larger one where needed."""
        if self._buffer is None or size > self.size:
            self.release()
            self._buffer = self._session.allocate(size, for_mapping=self._for_mapping)
            self.size = size
        return self._buffer

    def release(self) -> None:
        """Give the buffer back; the next `take` allocates a new one."""
        buffer, self._buffer, self.size = self._buffer, None, 0
        if buffer is not None:
            self._session.release(buffer)
