"""Clusters: short runs of records in Morton order, to each of which the tree above looks as to one primitive."""

from __future__ import annotations

import numpy as np
from numba import njit

from ...simd import empty_box, load_row, store_row, unite

# Most records in a cluster. More: less time; fewer: a better tree.
CLUSTER_SIZE = 32

# A cut halves the range or takes one bit of the code: more than there are of both.
_MOST_WAITING = 96


@njit(cache=True, nogil=True)
def find_cut(codes, begin, end):  # type: ignore[no-untyped-def]
    """Return where the highest bit that is not the same in all codes of a range changes; its middle if all are equal.

    After Lauterbach et al., "Fast BVH construction on GPUs" (2009).
    """
    differing = codes[begin] ^ codes[end - 1]
    if differing == 0:
        return begin + (end - begin) // 2
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


@njit(cache=True, nogil=True)
def cut_clusters(codes, count, begins):  # type: ignore[no-untyped-def]
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
    ends = np.empty(_MOST_WAITING, np.int64)  # of the ranges that wait, each begins where the one above it ends
    waiting, cluster_count, begin, end = 0, 0, 0, count
    while True:
        if end - begin > CLUSTER_SIZE:
            ends[waiting] = end
            waiting += 1
            end = find_cut(codes, begin, end)
            continue
        begins[cluster_count] = begin
        cluster_count += 1
        begin = end
        if waiting == 0:
            begins[cluster_count] = count
            return cluster_count
        waiting -= 1
        end = ends[waiting]


@njit(cache=True, nogil=True)
def bound_clusters(records, begins, cluster_count, boxes, wholes, row):  # type: ignore[no-untyped-def]
    """Write the box of each cluster, and the box of all.

    Parameters
    ----------
    records : (n, 8) float32
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
        for record in range(begins[cluster], begins[cluster + 1]):
            box = unite(load_row(records, record), box)
        store_row(boxes, cluster, box)
        whole = unite(box, whole)
    store_row(wholes, row, whole)
