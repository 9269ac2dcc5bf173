"""Rays in, hits out."""

from .hits.hits import AllHits, Hits
from .points.refine import ClosestPoints
from .rays.pieces import Progress
from .tracer import Tracer

__all__ = ["AllHits", "ClosestPoints", "Hits", "Progress", "Tracer"]
