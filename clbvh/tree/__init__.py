"""A finished tree, whoever built it: what it is, whether it is right, how good it is."""

from .bvh import Bvh
from .stats import TreeStats, measure_tree, sah_cost
from .validate import validate_tree

__all__ = ["Bvh", "TreeStats", "measure_tree", "sah_cost", "validate_tree"]
