"""The finished tree over a mesh, and everything that follows from it alone: checks, cost, depth, refit, files."""

from .bvh import Bvh, sah_cost
from .validate import validate_tree

__all__ = ["Bvh", "sah_cost", "validate_tree"]
