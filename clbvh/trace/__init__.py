"""Rays in, hits out."""

from .hits.hits import AllHits, Hits
from .hits.normals import Normals
from .points.refine import ClosestPoints
from .rays.pieces import Progress
from .tracer import Traceable, Tracer

__all__ = ["AllHits", "ClosestPoints", "Hits", "Normals", "Progress", "Traceable", "Tracer"]
