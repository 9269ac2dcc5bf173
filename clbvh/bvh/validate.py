"""The invariants of a tree, which every builder must keep and every traversal relies on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import ValidationError
from ..structs import NODE
from .bvh import Bvh


def validate_tree(bvh: Bvh, *, max_depth: int | None = None, max_leaf_size: int | None = None) -> None:
    """Check a tree against its mesh.

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
        primitive lies in exactly one leaf; each leaf's box is exactly the box of its triangles, each interior box
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
    nodes, prim_ids, faces = bvh.nodes, bvh.prim_ids, bvh.mesh.faces
    if nodes.dtype != NODE or prim_ids.dtype != np.int32:
        raise ValidationError(f"the tree's arrays have the wrong dtypes: {nodes.dtype}, {prim_ids.dtype}")
    if len(nodes) == 0 or len(nodes) > 2 * len(faces) - 1:
        raise ValidationError(f"a tree over {len(faces)} triangles cannot have {len(nodes)} nodes")
    first, count = nodes["first"].astype(np.int64), nodes["count"].astype(np.int64)

    _check_links(first, count)
    _check_leaves(first, count, prim_ids, len(faces))
    _check_boxes(bvh)
    if max_depth is not None:
        _check_depth(first, count, max_depth)
    if max_leaf_size is not None and count.max() > max_leaf_size:
        leaf = int(np.flatnonzero(count > max_leaf_size)[0])
        raise ValidationError(f"leaf {leaf} holds {count[leaf]} primitives; the limit is {max_leaf_size}")


def _check_links(first: NDArray[np.int64], count: NDArray[np.int64]) -> None:
    """Check that every node but the root is the child of exactly one interior node before it."""
    _refuse(count < 0, "node {} has a negative count")
    nodes = np.arange(len(first))
    interior = count == 0
    bad = interior & ((first <= nodes) | (first + 1 >= len(first)))
    _refuse(bad, "interior node {} does not have both its children behind it, inside the tree")
    children = np.concatenate([first[interior], first[interior] + 1])
    references = np.bincount(children, minlength=len(first))
    references[0] += 1
    _refuse(references != 1, "node {} is not reached exactly once")


def _check_leaves(
    first: NDArray[np.int64], count: NDArray[np.int64], prim_ids: NDArray[np.int32], face_count: int
) -> None:
    """Check that the leaves' ranges cover prim_ids once, and that it is a permutation of the faces."""
    if prim_ids.shape != (face_count,):
        raise ValidationError(f"the tree lists {prim_ids.size} primitives; the mesh has {face_count} triangles")
    leaf = count > 0
    _refuse(leaf & ((first < 0) | (first + count > face_count)), "leaf {} lists primitives outside the mesh")
    starts = np.zeros(face_count + 1, np.int64)
    np.add.at(starts, first[leaf], 1)
    np.add.at(starts, first[leaf] + count[leaf], -1)
    covered = np.cumsum(starts)[:-1]
    if (covered != 1).any():
        slot = int(np.flatnonzero(covered != 1)[0])
        owners = ", ".join(str(node) for node in np.flatnonzero(leaf & (first <= slot) & (slot < first + count)))
        raise ValidationError(f"prim_ids[{slot}] lies in {covered[slot]} leaves ({owners or 'none'}) instead of one")

    # The leaves cover every slot of prim_ids once, so each slot has an owner.
    leaves = np.flatnonzero(leaf)
    leaves = leaves[np.argsort(first[leaves])]
    owner = np.repeat(leaves, count[leaves])
    outside = np.flatnonzero((prim_ids < 0) | (prim_ids >= face_count))
    if len(outside):
        node, prim = owner[outside[0]], prim_ids[outside[0]]
        raise ValidationError(f"leaf {node} lists triangle {prim}, which the mesh does not have")
    uses = np.bincount(prim_ids, minlength=face_count)
    repeated = np.flatnonzero(uses[prim_ids] > 1)
    if len(repeated):
        prim = int(prim_ids[repeated[0]])
        owners = ", ".join(str(node) for node in owner[prim_ids == prim])
        raise ValidationError(f"triangle {prim} is listed {uses[prim]} times instead of once, in leaves {owners}")


def _check_depth(first: NDArray[np.int64], count: NDArray[np.int64], max_depth: int) -> None:
    """Check that no node lies deeper than the limit, level by level."""
    level, depth = np.zeros(1, np.int64), 0
    while len(level):
        if depth > max_depth:
            raise ValidationError(f"node {level.min()} lies {depth} levels deep; the limit is {max_depth}")
        children = first[level[count[level] == 0]]
        level, depth = np.concatenate([children, children + 1]), depth + 1


def _check_boxes(bvh: Bvh) -> None:
    """Check that every box is exactly the union of the boxes below it."""
    nodes = bvh.nodes
    leaves = np.flatnonzero(nodes["count"] > 0)
    leaves = leaves[np.argsort(nodes["first"][leaves], kind="stable")]
    corners = bvh.mesh.local_vertices[bvh.mesh.faces[bvh.prim_ids]]
    starts = nodes["first"][leaves]
    expected_min = np.minimum.reduceat(corners.min(axis=1), starts)
    expected_max = np.maximum.reduceat(corners.max(axis=1), starts)

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
    _refuse(wrong, "the box of node {} is not exactly the union of the boxes below it")


def _refuse(bad: NDArray[np.bool_], message: str) -> None:
    """Raise for the first node that is marked."""
    if bad.any():
        raise ValidationError(message.format(int(np.flatnonzero(bad)[0])))
