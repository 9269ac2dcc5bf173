"""The one line about a first run, which compiles for seconds: said when that begins, so that nobody waits in doubt."""

from __future__ import annotations

import sys
from contextlib import suppress

_DOING = "clbvh: compiling for this machine"


def say_first_run() -> None:
    """Print the line on stderr."""
    from ..support.cache_folder import find_cache, is_writable

    # Where nothing can be kept, that has been said, and it is no first run.
    ending = ", first run only; `clbvh warmup` does it ahead" if is_writable(find_cache()) else ""
    with suppress(OSError):  # nobody reads it, and the work goes on
        print(f"{_DOING}{ending}", file=sys.stderr, flush=True)
