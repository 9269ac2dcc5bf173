"""The three standard streams: there, able to take any text, and flushed with an error that is seen."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

_COUNT = 3


def prepare_streams() -> None:
    """Open the streams that are closed, and let those of an ASCII terminal take any name.

    A closed descriptor would be given to the next file that is opened, and a driver that prints would write there.
    """
    for descriptor in range(_COUNT):
        try:
            os.fstat(descriptor)
        except OSError:
            # The lowest free number, which is this one.
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            stream = open(os.devnull, "w")  # noqa: PTH123, SIM115 - lives as long as the process
            setattr(sys, name, stream)
        stream.reconfigure(errors="backslashreplace")


def flush_output() -> None:
    """Write what `print` still holds.

    Raises
    ------
    OSError
        It cannot be written. The rest is dropped, so that Python does not try again at its end.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OSError(error.errno, error.strerror, "standard output") from error
