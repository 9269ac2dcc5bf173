"""The build of `quality="fast"`; `fast.py` has the order of its steps."""

from .fast import build_fast

__all__ = ["build_fast"]
