"""The number of the next task, in memory that all workers share: whoever is free takes it, without a message.

The pool owns the memory, and sets it back before each round of tasks.
"""

from __future__ import annotations

from ...support.atomics import add_atomically
from ...support.compiled import compiled


@compiled
def take_number(counter):
    """Return the number of the next task, which no other worker gets.

    Parameters
    ----------
    counter : (8,) int64, shared by all workers
    """
    return add_atomically(counter, 1)
