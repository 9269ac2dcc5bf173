"""The check of all hits in worlds: whether they are all crossings that there can be, in their order."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clbvh.trace.check.intersections import ORACLE, Intersections, Rays
from clbvh.trace.check.reference import Reference, read_ids


def find_wrong_crossings(
    reference: Reference, rays: Rays, hits: Any, intersections: Intersections | None = None
) -> NDArray[np.int64]:
    """Return the rays whose crossings cannot be all that there are, or not in this order.

    Those surely miss a primitive that they are said to cross, or surely cross one that they are not; cross one too
    often; or their crossings are not in the order of t, or twins not in the order of their ids, or without one of them.
    """
    known = reference.intersections(rays) if intersections is None else intersections
    t, instance, prim = read_ids(hits)
    is_wrong, meant = np.zeros(len(rays.t_min), np.bool_), np.full(len(t), -1, np.int64)
    offsets, is_used = np.asarray(hits.offsets, np.int64), np.zeros(len(known.found), np.bool_)
    limits = rays.t_min, rays.t_max
    ORACLE.check_all_hits(known.words, *limits, t, instance, prim, is_wrong, meant, is_used, known.offsets, offsets)
    ray_of_hit = np.repeat(np.arange(len(is_wrong)), np.diff(offsets))
    checked = np.flatnonzero(~is_wrong[ray_of_hit])
    points = reference.check_points(rays, hits, known, checked, meant[checked])
    is_wrong[ray_of_hit[checked[points != 0]]] = True
    return np.flatnonzero(is_wrong)
