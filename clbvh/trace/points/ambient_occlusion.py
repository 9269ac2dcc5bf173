"""The share of the hemisphere over each point that is open, by rays that are drawn and cast on the device."""

from __future__ import annotations

import math
from numbers import Integral

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ...structs import HEMISPHERE
from ..launch import Caster, Query
from ..less_memory import cut_smaller_when_full
from ..rays.pieces import Progress
from ..room import check_room
from .hemispheres import Hemispheres, pack_hemispheres
from .order import find_point_order

AMBIENT_OCCLUSION = Query("ambient_occlusion", "open_counts", np.dtype(np.int32))

# Rays of a launch: between launches Ctrl-C is seen, and drivers of GPUs that draw the screen end long ones. On a
# 2-core x86-64 server it is about a second of work.
_LAUNCH_RAYS = 1 << 22

# Points of a launch, at least, so that every GPU is busy.
_LEAST_POINTS = 1 << 16

_MOST_RAYS = 1 << 24
_MOST_SEED = 0xFFFF_FFFF


def check_sampling(rays: int, seed: int) -> tuple[int, int]:
    """Return the number of rays at each point and the seed.

    Raises
    ------
    ConfigError
        One of them is no integer, or out of range.
    """
    for name, value, least, most in (("rays", rays, 1, _MOST_RAYS), ("seed", seed, 0, _MOST_SEED)):
        is_integer = isinstance(value, Integral) and not isinstance(value, bool)
        if not (is_integer and least <= value <= most):
            raise ConfigError(f"{name} must be an integer from {least} to {most}, not {value}")
    return int(rays), int(seed)


@cut_smaller_when_full
def find_open_shares(
    caster: Caster, hemispheres: Hemispheres, rays: int, seed: int, progress: Progress | None = None
) -> NDArray[np.float64]:
    """Return the share of rays over each point that meet nothing; see `Tracer.ambient_occlusion`."""
    count = math.prod(hemispheres.shape)
    check_room(count, 8, "points")
    shares = np.empty(count)
    in_scene = caster.tree.has_instances
    with caster.open_call() as call:
        most_points = max(_LEAST_POINTS, _LAUNCH_RAYS // rays)
        for begin, end in call.cut_points(count, progress, dtype=HEMISPHERE, most_points=most_points):
            rows = hemispheres.take(begin, end, call.box)
            order = find_point_order(rows.points, call.box, call.threads)

            def pack(first: int, last: int, packed: NDArray[np.void]) -> None:
                pack_hemispheres(rows, call.box, order[first:last], begin, packed, in_scene=in_scene)  # noqa: B023

            batch = call.pack_points(end - begin, pack, dtype=HEMISPHERE)
            open_counts = np.zeros(end - begin, np.int64)
            step = max(1, _LAUNCH_RAYS // (end - begin))
            for first_ray in range(0, rays, step):
                ray_count = min(step, rays - first_ray)
                with call.cast(
                    AMBIENT_OCCLUSION, batch,
                    first_ray=np.int32(first_ray), ray_count=np.int32(ray_count), seed=np.uint32(seed),
                ) as found:  # fmt: skip
                    open_counts[order] += found
            # Every mask but 0 sees a mesh without instances.
            hides_all = not in_scene and hemispheres.masks is not None
            shares[begin:end] = np.where(rows.masks == 0, 1.0, open_counts / rays) if hides_all else open_counts / rays
    return shares.reshape(hemispheres.shape)
