"""`clbvh fetch`: (being written)."""

from __future__ import annotations


def fetch() -> None:
    """Do it."""
