"""One sentence for the user about something that is no error: a cache that cannot be used, or why this takes seconds.

It goes to the logger ``clbvh``, which prints it on stderr unless the program has set up its own logging. A reason to
wait is printed there nevertheless: nobody looks into a log file while nothing happens.
"""

from __future__ import annotations

import hashlib
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

# Digests of the sentences that this process, or one that started it, has said: workers must not repeat them.
_VARIABLE = "_CLBVH_SAID"
_DIGITS = 8

# A kernel that is loaded from a driver's cache takes 0.07 s, and one that is compiled 0.4 s and more (PoCL 3.0).
_LONGEST_LOAD_S = 0.5


def say_once(sentence: str, about: str = "", *, is_on_stderr: bool = False) -> None:
    """Log a warning, unless this process or one that started it has done so.

    Sentences about the same thing count as one; without `about`, equal sentences do. With `is_on_stderr` it is printed
    there, too, if the program has set up its own logging and none of that is on stderr.
    """
    digest = hashlib.sha256((about or sentence).encode(errors="surrogateescape")).hexdigest()[:_DIGITS]
    said = os.environ.get(_VARIABLE, "")
    if digest in said.split(","):
        return
    os.environ[_VARIABLE] = f"{said},{digest}"
    import logging  # takes 10 ms, and most processes have nothing to say

    logger = logging.getLogger("clbvh")
    logger.warning("clbvh: %s", sentence)
    streams = [getattr(handler, "stream", None) for handler in (*logger.handlers, *logging.getLogger().handlers)]
    if is_on_stderr and streams and sys.stderr not in streams:
        print(f"clbvh: {sentence}", file=sys.stderr, flush=True)


def say_compiling(sentence: str = "compiling for this machine; `clbvh warmup` does it ahead") -> None:
    """Tell the user, once, that something is compiled, which takes seconds."""
    say_once(sentence, about="compiling", is_on_stderr=True)


@contextmanager
def saying_compiling_if_slow() -> Iterator[None]:
    """Say that a driver compiles if the block takes long; drivers do not say whether they compile or load."""
    timer = threading.Timer(_LONGEST_LOAD_S, say_compiling)
    timer.daemon = True
    with suppress(RuntimeError):  # the system has no more threads
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
