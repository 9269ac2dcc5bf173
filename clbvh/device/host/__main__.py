"""`python -m clbvh.device.host [LEVEL ...]`: compiles the library anew, for this processor or for the levels named."""

import sys
import time

from .compile import build_library, check_levels, find_level, find_objects
from .library import library_path

if __name__ == "__main__":
    begin_s = time.monotonic()
    levels = sys.argv[1:] or [find_level()]
    check_levels(levels)
    build_library(library_path(), find_objects(), levels)
    print(f"{library_path()}: {', '.join(levels)}, {time.monotonic() - begin_s:.0f} s")
