"""The command line: one file per verb, and the only place that prints.

A worker process imports this file, and no other of the command line, when it starts; so it stays nearly empty.
"""

from __future__ import annotations


def main() -> None:
    """Run the `clbvh` command."""
    # Streams first: the next file that is opened would get the number of a closed one.
    from .streams import prepare_streams

    prepare_streams()
    from .ending import ending_at_once
    from .garbage import collect_rarely, uncollected

    collect_rarely()
    with ending_at_once():
        # Everything that follows can be interrupted.
        from .signals import end_on_signals

        end_on_signals()
        with uncollected():
            from .app import run

        run()
