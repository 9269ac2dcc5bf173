"""Numbers as text: three digits, thousands with commas, and the range behind a median."""

from __future__ import annotations

import math

from ..statistics import Summary
from .parts import Cell

_DIGITS = 3
MISSING = "\u2013"  # a dash


def format_number(value: float) -> str:
    """Return a number with three significant digits; whole numbers in full."""
    if isinstance(value, int):
        return f"{value:,}"
    if not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    decimals = max(0, _DIGITS - 1 - math.floor(math.log10(abs(value))))
    return f"{value:,.{min(decimals, 6)}f}"


def format_range(summary: Summary) -> str:
    """Return the smallest and the largest sample of a summary, empty for one sample."""
    if summary.count < 2:
        return ""
    return f"{format_number(summary.low)} to {format_number(summary.high)}"


def format_cell(cell: Cell) -> str:
    """Return a cell of a table in plain text."""
    if cell is None:
        return MISSING
    if isinstance(cell, str):
        return cell
    if isinstance(cell, Summary):
        spread = format_range(cell)
        return f"{format_number(cell.median)} ({spread})" if spread else format_number(cell.median)
    return format_number(cell)
