"""`clbvh devices`: (being written)."""

from __future__ import annotations


def devices() -> None:
    """Do it."""
