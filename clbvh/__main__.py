"""``python -m clbvh`` is the command ``clbvh``."""

from __future__ import annotations

from .cli import main

# Worker processes import this file, too.
if __name__ == "__main__":
    main()
