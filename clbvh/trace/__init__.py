"""Rays in, hits out."""

from typing import TYPE_CHECKING

from ..support.lazy_imports import import_on_use

if TYPE_CHECKING:
    from .hits.hits import AllHits, Hits
    from .hits.normals import Normals
    from .points.refine import ClosestPoints
    from .rays.pieces import Progress
    from .tracer import Traceable, Tracer

__all__ = ["AllHits", "ClosestPoints", "Hits", "Normals", "Progress", "Traceable", "Tracer"]

# A picture needs the parts of this room, and no tracer.
__getattr__ = import_on_use(
    __name__,
    {
        "AllHits": "hits.hits",
        "Hits": "hits.hits",
        "Normals": "hits.normals",
        "ClosestPoints": "points.refine",
        "Progress": "rays.pieces",
        "Traceable": "tracer",
        "Tracer": "tracer",
    },
)
