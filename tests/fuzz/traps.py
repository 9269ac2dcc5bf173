"""Readers that fail in every way that the fuzz must notice; for its own tests."""

from __future__ import annotations

import os
import signal
import time
import warnings
from collections.abc import Callable

from clbvh.errors import DeviceError, MeshError

from .readers import Reader, accepts

MEMORY_BYTES = 512 << 20  # that a worker may take beyond what it has after every reader has read its valid files


def _run_out_of_memory() -> None:
    try:
        bytearray(2 * MEMORY_BYTES)
    except MemoryError as error:
        raise MeshError("there is not enough memory") from error


def _blame_the_machine() -> None:
    raise DeviceError("this is no fault of the file")


def _make(read: Callable[[], object]) -> Reader:
    return Reader([], lambda generator: generator.randbytes(1), lambda *_: accepts(read))


TRAPS = {
    "raises": _make(lambda: [][0]),
    "warns": _make(lambda: warnings.warn("a value is odd", RuntimeWarning, stacklevel=2)),
    "grows": _make(_run_out_of_memory),
    "blames": _make(_blame_the_machine),
    "dies": _make(lambda: os.kill(os.getpid(), signal.SIGKILL)),
    "hangs": _make(lambda: time.sleep(1000)),
}
