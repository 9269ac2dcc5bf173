"""The trees of the ladder in plain Python, written for comparison only: recursive, one primitive after the other."""

from __future__ import annotations

import numpy as np

from clbvh.structs import NODE


def halve_by_median(centroids, prims, bins):
    """Return both halves of the primitives in the order of their centroids on the longest axis."""
    extents = np.ptp(centroids[prims].astype(np.float64), axis=0)
    axis = int(np.argmax(extents))
    ordered = sorted(prims, key=lambda prim: (centroids[prim, axis], prim))
    return ordered[: len(prims) // 2], ordered[len(prims) // 2 :]


def cut_between_bins(centroids, prims, bins):
    """Return the sides of that boundary between two bins that comes nearest to halves."""
    points = centroids[prims].astype(np.float64)
    extents = np.ptp(points, axis=0)
    axis = int(np.argmax(extents))
    if extents[axis] == 0:
        return prims[: len(prims) // 2], prims[len(prims) // 2 :]
    numbers = np.minimum(((points[:, axis] - points[:, axis].min()) * (bins / extents[axis])).astype(int), bins - 1)
    boundary = min(range(bins - 1), key=lambda last: abs(2 * int((numbers <= last).sum()) - len(prims)))
    goes_left = numbers <= boundary
    return [p for p, left in zip(prims, goes_left, strict=True) if left], [
        p for p, left in zip(prims, goes_left, strict=True) if not left
    ]


def build_by_reference(mesh, divide, leaf_size, bins=8):
    """Return the nodes and the prim_ids of the tree that `divide` makes; it must not get too deep for recursion."""
    corners = mesh.local_vertices[mesh.faces] + np.float32(0)
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    centroids = np.float32(0.5) * lower + np.float32(0.5) * upper
    nodes, prim_ids = [None], []

    def build(row, prims):
        box = lower[prims].min(axis=0), upper[prims].max(axis=0)
        if len(prims) <= leaf_size:
            nodes[row] = (box[0], len(prim_ids), box[1], len(prims))
            prim_ids.extend(sorted(prims))
            return
        first = len(nodes)
        nodes[row] = (box[0], first, box[1], 0)
        nodes.extend([None, None])
        left, right = divide(centroids, prims, bins)
        build(first, left)
        build(first + 1, right)

    build(0, list(range(mesh.face_count)))
    return np.array(nodes, NODE), np.array(prim_ids, np.int32)
