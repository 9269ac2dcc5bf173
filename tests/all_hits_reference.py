"""The check of all hits in worlds: whether they are all crossings that there can be, in their order."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clbvh.support.compiled import compiled
from clbvh.trace.check.intersections import Intersections, Rays
from clbvh.trace.check.reference import Reference, are_twins, limit_t, read_ids, slack_of


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
    offsets = np.asarray(hits.offsets, np.int64)
    _check_hits(known, rays.t_min, rays.t_max, offsets, t, instance, prim, is_wrong, meant)
    ray_of_hit = np.repeat(np.arange(len(is_wrong)), np.diff(offsets))
    checked = np.flatnonzero(~is_wrong[ray_of_hit])
    points = reference.check_points(rays, hits, known, checked, meant[checked])
    is_wrong[ray_of_hit[checked[points != 0]]] = True
    return np.flatnonzero(is_wrong)


@compiled
def _check_hits(known, t_mins, t_maxs, offsets, ts, instances, prims, is_wrong, meant_of):
    """Write which rays' crossings are wrong, and which crossings are meant; see `find_wrong_crossings`."""
    is_used = np.zeros(len(known.t), np.bool_)
    for ray in range(len(is_wrong)):
        begin, end = known.offsets[ray], known.offsets[ray + 1]
        latest = -np.inf
        for hit in range(offsets[ray], offsets[ray + 1]):
            # Each crossing found is one that there can be. A t may be raised to that of the crossing before it.
            for raised in (-np.inf, latest):
                for meant in range(begin, end):
                    low, high = limit_t(known, meant, t_mins[ray], t_maxs[ray])
                    if (
                        meant_of[hit] < 0
                        and not is_used[meant]
                        and known.instance_id[meant] == instances[hit]
                        and known.prim_id[meant] == prims[hit]
                        and low <= ts[hit] <= max(high, raised)
                    ):
                        is_used[meant] = True
                        meant_of[hit] = meant
            meant = meant_of[hit]
            if meant < 0 or (hit > offsets[ray] and not ts[hit] >= ts[hit - 1]):
                is_wrong[ray] = True
                break
            latest = max(latest, limit_t(known, meant, t_mins[ray], t_maxs[ray])[1])

            # None of those before it is surely behind it; and of twins, those with smaller ids come first.
            for before in range(offsets[ray], hit):
                earlier = meant_of[before]
                if known.t_high[meant] + slack_of(known, meant, earlier) < known.t_low[earlier]:
                    is_wrong[ray] = True
                if are_twins(known, meant, earlier) and (
                    instances[hit] < instances[before]
                    or (instances[hit] == instances[before] and prims[hit] < prims[before])
                ):
                    is_wrong[ray] = True

        # None that is sure is missing, and no twin of one that is found.
        for index in range(begin, end):
            if is_used[index]:
                continue
            is_wrong[ray] |= known.is_sure[index]
            for other in range(begin, end):
                is_wrong[ray] |= is_used[other] and are_twins(known, index, other)
