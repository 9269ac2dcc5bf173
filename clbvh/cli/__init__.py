"""The command line: one file per verb, and the only place that prints.

This file is all that a worker process imports of the command line when it starts, so it stays nearly empty.
"""

from __future__ import annotations


def main() -> None:
    """Run the `clbvh` command."""
    from .app import run

    run()
