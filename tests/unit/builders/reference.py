"""What the builders compute, in plain numpy and Python, written for comparison only."""

from __future__ import annotations

import numpy as np

from clbvh.builders.prim_refs import fill_slice
from clbvh.structs import BOX_LANES, MAX_DEPTH, NODE


def make_prim_refs(mesh):
    """Return the (2, n, 8) buffers that a build starts with, and the (2, 8) bounds of all."""
    prim_refs = np.zeros((2, mesh.face_count, BOX_LANES), np.float32)
    return prim_refs, fill_slice(mesh.find_corners(), 0, mesh.face_count, prim_refs[0])


def cost_of(rows):
    """Return half the area of the box around the rows, for each of them."""
    lower = rows.astype(np.float64).min(axis=0)
    x, y, z = -lower[4:7] - lower[:3]
    return (x * y + y * z + z * x) * len(rows)


def bins_of(rows, bin_count):
    """Return the bin of each reference on each axis, (n, 3), after the formula of the builder in float32."""
    centroids = rows[:, :3] - rows[:, 4:7]
    extent = np.ptp(centroids, axis=0)
    scale = np.zeros(3, np.float32)
    wide = extent > 2.0**-110
    scale[wide] = np.float32(bin_count) * np.float32(0.99999) / extent[wide]
    return ((centroids - centroids.min(axis=0)) * scale).astype(np.int64)


def list_divisions(rows, bins):
    """Yield which references go left, for each division of a node that the builder tries, in its order."""
    if len(rows) <= 4:
        for mask in {2: [1], 3: [1, 3, 5], 4: [3, 5, 9, 1, 13, 11, 7]}[len(rows)]:
            yield mask >> np.arange(len(rows)) & 1 == 1
        return
    bin_count = min(bins, max(4, len(rows) // 4))
    for numbers in bins_of(rows, bin_count).T:
        for last_left in range(bin_count - 1):
            goes_left = numbers <= last_left
            if goes_left.any() and not goes_left.all():
                yield goes_left


def build_sah(mesh, bins, leaf_size, traversal_cost):
    """Return the nodes and the prim_ids of the default builder's tree: the first of the cheapest divisions."""
    nodes, prim_ids = [None], []

    def build(row, rows, depth):
        best_cost, goes_left = np.inf, np.arange(len(rows)) < len(rows) // 2
        if len(rows) > 1 and np.ceil(np.log2(len(rows))) < MAX_DEPTH - depth:
            for division in list_divisions(rows, bins):
                cost = cost_of(rows[division]) + cost_of(rows[~division])
                if cost < best_cost:
                    best_cost, goes_left = cost, division
        box, whole = rows.min(axis=0), cost_of(rows)
        is_leaf = len(rows) <= leaf_size and not traversal_cost * (whole / len(rows)) + best_cost < whole
        first = len(prim_ids) if is_leaf else len(nodes)
        nodes[row] = (box[:3], first, 0 - box[4:7], len(rows) if is_leaf else 0)
        if is_leaf:
            prim_ids.extend(rows.view(np.int32)[:, 3])
            return
        nodes.extend([None, None])
        build(first, rows[goes_left], depth + 1)
        build(first + 1, rows[~goes_left], depth + 1)

    build(0, make_prim_refs(mesh)[0][0], 0)
    return np.array(nodes, NODE), np.array(prim_ids, np.int32)


def halve_by_median(points, prims, bins):
    """Return both halves of the primitives in the order of their centroids on the longest axis."""
    axis = int(np.argmax(np.ptp(points[prims].astype(np.float64), axis=0)))
    ordered = sorted(prims, key=lambda prim: (points[prim, axis], prim))
    return ordered[: len(prims) // 2], ordered[len(prims) // 2 :]


def cut_between_bins(points, prims, bins):
    """Return the sides of that boundary between two bins that comes nearest to halves."""
    here = points[prims].astype(np.float64)
    extents = np.ptp(here, axis=0)
    axis = int(np.argmax(extents))
    if extents[axis] == 0:
        return prims[: len(prims) // 2], prims[len(prims) // 2 :]
    numbers = np.minimum(((here[:, axis] - here[:, axis].min()) * (bins / extents[axis])).astype(int), bins - 1)
    boundary = min(range(bins - 1), key=lambda last: abs(2 * int((numbers <= last).sum()) - len(prims)))
    sides = np.array(prims)
    return sides[numbers <= boundary].tolist(), sides[numbers > boundary].tolist()


def build_ladder(mesh, divide, leaf_size, bins=8):
    """Return the nodes and the prim_ids of the ladder's tree by `divide`; not too deep for recursion."""
    corners = mesh.local_vertices[mesh.faces] + np.float32(0)
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    points = np.float32(0.5) * lower + np.float32(0.5) * upper
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
        for side, half in enumerate(divide(points, prims, bins)):
            build(first + side, half)

    build(0, list(range(mesh.face_count)))
    return np.array(nodes, NODE), np.array(prim_ids, np.int32)
