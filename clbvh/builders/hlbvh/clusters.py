"""Clusters: short runs of primitive references in Morton order; the tree above treats each as one primitive."""

from __future__ import annotations

import numpy as np

from ...geometry.boxes import empty_box, load_box, store_box, unite
from ...support.compiled import compiled
from ..halving import middle_of

# Most primitive references in a cluster. More: less time; fewer: a better tree.
CLUSTER_SIZE = 32

# A cut halves the range or takes one bit of the code: more than there are of both.
_STACK_SIZE = 96


@compiled
def find_cut(codes, begin, end):
    """Return where the highest bit that is not the same in all codes of a range changes; its middle if all are equal.

    After Lauterbach et al., "Fast BVH construction on GPUs" (2009).
    """
    differing = codes[begin] ^ codes[end - 1]
    if differing == 0:
        return middle_of(begin, end)
    while differing & (differing - 1):
        differing &= differing - 1
    first_above = codes[end - 1] & -differing
    lower, upper = begin, end - 1
    while lower < upper:
        middle = (lower + upper) >> 1
        if codes[middle] >= first_above:
            upper = middle
        else:
            lower = middle + 1
    return lower


@compiled
def cut_clusters(codes, count, begins):
    """Cut sorted codes until no run is longer than `CLUSTER_SIZE`.

    Parameters
    ----------
    codes : (>= count,) int32
    begins : (>= count + 1,) int32, written
        Where each cluster begins, and where the last one ends.

    Returns
    -------
    int
        Number of clusters.
    """
    stack = np.empty(_STACK_SIZE, np.int64)  # ends of ranges; each begins where the one above it in the stack ends
    stack_size, cluster_count, begin, end = 0, 0, 0, count
    while True:
        if end - begin > CLUSTER_SIZE:
            stack[stack_size] = end
            stack_size += 1
            end = find_cut(codes, begin, end)
            continue
        begins[cluster_count] = begin
        cluster_count += 1
        begin = end
        if stack_size == 0:
            begins[cluster_count] = count
            return cluster_count
        stack_size -= 1
        end = stack[stack_size]


@compiled
def bound_clusters(refs, begins, cluster_count, boxes, wholes, row):
    """Write the box of each cluster, and the box of all.

    Parameters
    ----------
    refs : (n, 8) float32
        In Morton order.
    begins : (>= cluster_count + 1,) int32
        See `cut_clusters`.
    boxes : (>= cluster_count, 8) float32, written
    wholes : (k, 8) float32, written
        `wholes[row]` becomes the box of all.
    """
    whole = empty_box()
    for cluster in range(cluster_count):
        box = empty_box()
        for index in range(begins[cluster], begins[cluster + 1]):
            box = unite(load_box(refs, index), box)
        store_box(boxes, cluster, box)
        whole = unite(box, whole)
    store_box(wholes, row, whole)
