"""The build of `quality="fast"`; `build_hlbvh.py` has the order of its steps."""

from .build_hlbvh import build_hlbvh

__all__ = ["build_hlbvh"]
