"""Measures of a finished tree, and charts of them."""

from .tree_stats import TreeStats, measure_tree

__all__ = ["TreeStats", "measure_tree"]
