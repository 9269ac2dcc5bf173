"""Rays in, hits out."""

from .hits import Hits
from .tracer import Tracer

__all__ = ["Hits", "Tracer"]
