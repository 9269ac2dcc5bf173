"""Interrupts work at a chosen time, as Ctrl-C does."""

import signal
from contextlib import suppress

import numpy as np


def interrupt(work, delay_s):
    """Call a function and interrupt it after a while; return whether it came to its end, and its result or None."""
    is_done, result = False, None
    try:
        signal.setitimer(signal.ITIMER_REAL, delay_s)
        result = work()
        is_done = True
    except KeyboardInterrupt:
        pass
    except SystemError as error:
        # numba calls Python on the way out of a compiled function, and does not look whether that has raised.
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    # Native code may keep the exception to itself; the next array that numpy makes of a number then raises it.
    with suppress(KeyboardInterrupt):
        np.array([0.5])
    return is_done, result
