"""The line that a command prints when it begins to compile: a first run takes seconds longer."""

from __future__ import annotations

import sys
from contextlib import suppress

_DOING = "clbvh: compiling for this machine"


def say_first_run() -> None:
    """Print the line on stderr."""
    from ..support.cache_folder import find_cache, is_writable

    # Without a writable cache every run compiles, and a warning has said so.
    ending = ", first run only; `clbvh warmup` does it ahead" if is_writable(find_cache()) else ""
    with suppress(OSError):  # nobody reads it, and the work goes on
        print(f"{_DOING}{ending}", file=sys.stderr, flush=True)
