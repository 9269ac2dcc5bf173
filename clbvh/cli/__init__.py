"""The command line: one file per command, and the only folder that prints.

A worker process imports this file, and no other of the command line, when it starts; so it stays nearly empty.
"""

from __future__ import annotations

import sys


def main() -> None:
    """Run the `clbvh` command."""
    from .signals import clean_up_on_signals, end_on_signals

    # Everything that follows can be interrupted.
    end_on_signals()
    if not {"--help", "-h", "--version"}.intersection(sys.argv):  # texts, which come quickly and leave nothing behind
        clean_up_on_signals()
    if sys.stdout is not None:
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr] # an ASCII terminal shows any name
    from .app import run

    run()
