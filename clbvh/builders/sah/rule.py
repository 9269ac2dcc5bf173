"""The rule of the surface area heuristic: when a node becomes a leaf, and how finely splits are looked for."""

from __future__ import annotations

from typing import NamedTuple

from ..options import BuildOptions

DEFAULT_BINS = 16


class Rule(NamedTuple):
    """The options of a build that decide about a node; see `BuildOptions`.

    Attributes
    ----------
    bins, leaf_size : int
    traversal_cost : float
    """

    bins: int
    leaf_size: int
    traversal_cost: float


def make_rule(options: BuildOptions) -> Rule:
    """Return the rule that these options ask for."""
    return Rule(options.bins or DEFAULT_BINS, options.leaf_size, options.traversal_cost)
