"""Rays in, hits out."""

from .hits import AllHits, Hits
from .tracer import Tracer

__all__ = ["AllHits", "Hits", "Tracer"]
