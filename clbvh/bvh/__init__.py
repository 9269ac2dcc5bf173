"""The finished tree, and what follows from it alone: checks, SAH cost, refit, saved trees."""

from .bvh import Bvh, sah_cost
from .validate import validate_tree

__all__ = ["Bvh", "sah_cost", "validate_tree"]
