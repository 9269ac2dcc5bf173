"""Rays in, hits out."""

from .hits.hits import AllHits, Hits
from .points.refine import ClosestPoints
from .tracer import Tracer

__all__ = ["AllHits", "ClosestPoints", "Hits", "Tracer"]
