"""Rays on their way to the device: in the tree's local coordinates in float64, then packed in float32.

The device sees meshes and directions of about one size, whatever the user's unit: the mesh is scaled by a power of two,
and so is each direction, to a longest component from 1 to 2. Powers of two round nothing, so that a mesh and its rays
give the same hits at every size.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ...errors import QueryError
from ...structs import PACKED_RAY, RAY_LOW
from ..world.tree_box import TreeBox
from .batch import RayBatch, too_far

_LOOPS = Loops("rays/pack")

# What `write_packed` of cl/host/rays/pack.cl returns where no ray is bad.
_ALL_GOOD, _NOT_SHARED = -1, -2

# Origins that are compared before rays are packed as those of one camera.
_SAMPLED_ORIGINS = 16


def pack_rays(
    batch: RayBatch,
    box: TreeBox,
    packed: NDArray[np.void],
    *,
    order: NDArray[np.int32] | None = None,
    first_ray: int = 0,
    lows: NDArray[np.void] | None = None,
    shared_low: NDArray[np.void] | None = None,
) -> bool:
    """Write rays as the device takes them. They are scaled, and some are advanced: their t is not the user's.

    Parameters
    ----------
    batch : RayBatch
    box : TreeBox
    packed : (n,) `structs.PACKED_RAY`, written
    order : (n,) int32, optional
        Rays to write, counted from the first one; all from there on, in their own order, without it.
    first_ray : int, optional
    lows : (n,) `structs.RAY_LOW` or `structs.EXACT_RAY`, optional, written
        For the rays of a scene, or of a world that spans scales.
    shared_low : (1,) `structs.RAY_LOW`, optional
        Instead of `lows`, from `find_shared_low`.

    Returns
    -------
    bool
        False if float32 has rounded something else off the origin of a ray than `shared_low` says: then the rays are
        to be packed again, with `lows`.

    Raises
    ------
    QueryError
        A value is not finite, a direction has length zero, or an origin's distance in sizes of the mesh is beyond
        float64; the message names the first bad ray.
    """
    given, numbers = (batch.addresses, first_ray), box.as_numbers()
    of_rays = lows if lows is not None and lows.dtype == RAY_LOW else None
    bad = _LOOPS.write_packed(*given, numbers, order, packed, of_rays, lows if of_rays is None else None, shared_low)
    if bad == _NOT_SHARED:
        return False
    if bad != _ALL_GOOD and order is not None:
        # In another order, it need not be the first bad ray.
        whole = np.empty(int(order.max()) + 1, PACKED_RAY)
        bad = _LOOPS.write_packed(*given, numbers, None, whole, None, None, None)
    if bad != _ALL_GOOD:
        raise explain_bad_ray(batch, first_ray + bad)
    return True


def check_rays(batch: RayBatch, box: TreeBox, begin: int, end: int) -> None:
    """Raise as `pack_rays` for rays `begin` to `end`."""
    pack_rays(batch, box, np.empty(end - begin, PACKED_RAY), first_ray=begin)


def find_shared_low(
    batch: RayBatch, box: TreeBox, begin: int, end: int, *, reads_direction: bool
) -> NDArray[np.void] | None:
    """Return the `structs.RAY_LOW` that rays `begin` to `end` share, (1,), or None if a sample says that they do not.

    Parameters
    ----------
    batch : RayBatch
    box : TreeBox
    begin, end : int
    reads_direction : bool
        Whether the device reads the low parts of directions.

    Raises
    ------
    QueryError
        As `pack_rays`, for the first ray.
    """
    rows = batch.rows
    if not rows.mask.is_one:
        return None
    # Scaling by a power of two leaves nothing of a direction in float32 to be rounded off.
    if reads_direction and rows.directions.items.dtype != np.float32:
        return None
    if not rows.origins.is_one:
        sample = rows.origins.take(np.linspace(begin, end - 1, _SAMPLED_ORIGINS).astype(np.int64)).items
        if (sample != sample[0]).any():
            return None
    packed, low = np.empty(1, PACKED_RAY), np.zeros(1, RAY_LOW)
    pack_rays(batch, box, packed, first_ray=begin, lows=low)
    low["direction"] = 0.0
    return low


def explain_bad_ray(batch: RayBatch, ray_id: int) -> QueryError:
    """Return the error for a bad ray."""
    rows = batch.rows
    (origin,), (direction,) = (rows[lane].part(ray_id, ray_id + 1, rows[lane].items.dtype) for lane in range(2))
    subjects = rows.origins.subject("origins", ray_id), rows.directions.subject("directions", ray_id)
    for subject, values in zip(subjects, (origin, direction), strict=True):
        if not np.isfinite(values).all():
            return QueryError(f"{subject} is not finite: {values}")
    if direction.any():
        return too_far(subjects[0], origin)
    return QueryError(f"{subjects[1]} has length zero")
