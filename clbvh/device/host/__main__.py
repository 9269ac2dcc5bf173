"""`python -m clbvh.device.host [LEVEL ...]`: compiles the library anew, for this processor or for the levels named."""

import sys
import time

from ...errors import ClbvhError
from .compile import build_library, check_levels, find_level, find_objects
from .library import library_path


def main() -> None:
    """Compile, and say what and how long."""
    begin_s = time.monotonic()
    levels = sys.argv[1:] or [find_level()]
    check_levels(levels)
    build_library(library_path(), find_objects(), levels)
    print(f"{library_path()}: {', '.join(levels)}, {time.monotonic() - begin_s:.0f} s")


if __name__ == "__main__":
    try:
        main()
    except ClbvhError as error:
        sys.exit(f"clbvh: {error}")
