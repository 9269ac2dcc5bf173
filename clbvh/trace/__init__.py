"""Rays in, hits out."""

from .hits import AllHits, Hits
from .points import ClosestPoints
from .tracer import Tracer

__all__ = ["AllHits", "ClosestPoints", "Hits", "Tracer"]
