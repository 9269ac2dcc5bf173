"""Splits by halves, the last resort of every builder that promises `MAX_DEPTH`.

A split into halves by position needs ``ceil(log2(n))`` levels for n primitives, whatever their boxes. As soon as that
many levels are all that is left, a builder takes no other split.
"""

from __future__ import annotations

from ..support.compiled import compiled
from .options import MAX_DEPTH


@compiled
def needs_halving(prim_count, depth):
    """Say whether only splits by halves still keep `prim_count` primitives, at `depth`, above `MAX_DEPTH`."""
    levels = 0
    while (1 << levels) < prim_count:
        levels += 1
    return levels >= MAX_DEPTH - depth


@compiled
def middle_of(begin, end):
    """Return where the right half of a range begins."""
    return begin + (end - begin) // 2
