"""`clbvh render`: (being written)."""

from __future__ import annotations


def render() -> None:
    """Do it."""
