"""The command line: one file per verb, and the only place that prints.

A worker process imports this file, and no other of the command line, when it starts; so it stays nearly empty.
"""

from __future__ import annotations

import sys


def main() -> None:
    """Run the `clbvh` command."""
    from .signals import end_on_signals

    # Everything that follows can be interrupted.
    end_on_signals()
    if sys.stdout is not None:
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr] # an ASCII terminal shows any name
    from .app import run

    run()
