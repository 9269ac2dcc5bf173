"""Python's collector of reference cycles, in a process that lasts for one command.

Owns its settings, which a library must leave to its user's program. Nearly all objects of a command are those of the
imported modules, half a million of them, and none is garbage. The collector would look at them several times while
they are imported, and again when the process ends: that was a quarter of the processor time of a small picture (0.5 of
2.0 s on a 2-core x86-64 server, Python 3.11).
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

# Collections of the middle generation, of about 7,000 new objects each, before one of all objects; Python's own is 10.
# So modules are imported without one. From Python 3.14 on, this number has no meaning.
_MIDDLE_COLLECTIONS = 100


def collect_rarely() -> None:
    """Let the collector look at old objects rarely."""
    young, middle, _ = gc.get_threshold()
    gc.set_threshold(young, middle, _MIDDLE_COLLECTIONS)


@contextmanager
def uncollected() -> Iterator[None]:
    """Let all objects that a block of imports makes live for ever, and look for no garbage among them."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
