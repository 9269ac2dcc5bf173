"""The invariants of a tree, which every builder must keep and every traversal relies on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import ValidationError
from ..geometry.corners import Corners
from ..structs import NODE
from .bvh import Bvh
from .links import check_links, refuse_nodes


def validate_tree(bvh: Bvh, *, max_depth: int | None = None, max_leaf_size: int | None = None) -> None:
    """Check a tree against its shape.

    Parameters
    ----------
    bvh : Bvh
    max_depth, max_leaf_size : int, optional
        Limits that the builder promised.

    Raises
    ------
    ValidationError
        An invariant does not hold; the message names the first node that breaks it. The invariants: nodes and
        primitives have the right types and counts; siblings lie behind their parent; each node is reached once; each
        primitive lies in exactly one leaf; each leaf's box is exactly the box of its primitives, each interior box
        exactly the union of its children's.

    Notes
    -----
    O(n) in nodes and primitives, in numpy alone: it shares no code with the builders.

    Examples
    --------
    >>> import clbvh
    >>> from dataclasses import replace
    >>> bvh = clbvh.build(clbvh.make_shape("icosphere", triangles=1000))
    >>> clbvh.validate_tree(bvh, max_leaf_size=4)
    >>> clbvh.validate_tree(replace(bvh, prim_ids=bvh.prim_ids[::-1].copy()))
    Traceback (most recent call last):
    clbvh.errors.ValidationError: ...
    """
    nodes, prim_ids, corners = bvh.nodes, bvh.prim_ids, bvh.shape.find_corners()
    if nodes.dtype != NODE or prim_ids.dtype != np.int32:
        raise ValidationError(f"the tree's arrays have the wrong dtypes: {nodes.dtype}, {prim_ids.dtype}")
    first, count = nodes["first"].astype(np.int64), nodes["count"].astype(np.int64)
    check_links(first, count, prim_ids, len(corners.ids))
    _check_boxes(bvh, corners)
    if max_depth is not None:
        _check_depth(first, count, max_depth)
    if max_leaf_size is not None and count.max() > max_leaf_size:
        leaf = int(np.flatnonzero(count > max_leaf_size)[0])
        raise ValidationError(f"leaf {leaf} holds {count[leaf]} primitives; the limit is {max_leaf_size}")


def _check_depth(first: NDArray[np.int64], count: NDArray[np.int64], max_depth: int) -> None:
    """Check that no node lies deeper than the limit, level by level."""
    level, depth = np.zeros(1, np.int64), 0
    while len(level):
        if depth > max_depth:
            raise ValidationError(f"node {level.min()} lies {depth} levels deep; the limit is {max_depth}")
        children = first[level[count[level] == 0]]
        level, depth = np.concatenate([children, children + 1]), depth + 1


def _check_boxes(bvh: Bvh, corners: Corners) -> None:
    """Check that every box is exactly the union of the boxes below it."""
    nodes = bvh.nodes
    leaves = np.flatnonzero(nodes["count"] > 0)
    leaves = leaves[np.argsort(nodes["first"][leaves], kind="stable")]
    points = corners.points[corners.ids[bvh.prim_ids]]
    starts = nodes["first"][leaves]
    expected_min = np.minimum.reduceat(points.min(axis=1), starts)
    expected_max = np.maximum.reduceat(points.max(axis=1), starts)

    interior = np.flatnonzero(nodes["count"] == 0)
    left = nodes["first"][interior]
    wrong = np.zeros(len(nodes), bool)
    for field, expected, unite in (
        ("aabb_min", expected_min, np.minimum),
        ("aabb_max", expected_max, np.maximum),
    ):
        boxes = nodes[field]
        # Written so that NaN fails.
        wrong[leaves] |= ~(boxes[leaves] == expected).all(axis=1)
        wrong[interior] |= ~(boxes[interior] == unite(boxes[left], boxes[left + 1])).all(axis=1)
    refuse_nodes(np.flatnonzero(wrong), "the box of node {} is not exactly the union of the boxes below it")
