"""Rays on the host: one kernel reads the user's arrays, casts, refines, and writes the answers where they are wanted.

See cl/on_host/world/rays.cl.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..device.host.library import Address, find_addresses
from ..device.host.session import LEAST_GROUPS
from ..device.settings import Settings
from .launch import Caster
from .rays import pieces
from .rays.batch import RayBatch
from .rays.pack import check_rays, explain_bad_ray
from .rays.pieces import RayPiece
from .world.world import World

# The number of the first bad ray, where none is.
_NO_RAY = np.iinfo(np.int32).max
_ALL_GOOD = np.array([_NO_RAY], np.int32)


def are_few(caster: Caster, batch: RayBatch) -> bool:
    """Return whether rays are cast as they are, neither cut nor sorted, and on the host."""
    return batch.ray_count < pieces.LEAST_RAYS and caster.session.info.is_host


def cast_here(
    device: Caster, kernel_name: str, batch: RayBatch, piece: RayPiece, arrays: Iterable[NDArray[Any] | None],
    *numbers: int,
) -> None:  # fmt: skip
    """Cast the rays of a piece on the host.

    Parameters
    ----------
    device : Caster
        Of the host.
    kernel_name : str
    batch : RayBatch
    piece : RayPiece
        Of the batch; it has rays.
    arrays : iterable of array or None
        The kernel's own arguments, in their order: what it writes and reads, contiguous.
    *numbers
        Those behind them.

    Raises
    ------
    QueryError
        As `pack_rays`.
    InternalError
        As `Caster.kernel_at_world`.
    """
    kernel, used = device.kernel_at_world(kernel_name)
    rays = describe_rays(device.session.settings, device.world, batch, piece)
    columns, rows = rays.work_size
    launch = kernel.bind_numbers((columns, rows, 1, 1), (*rays.numbers, *find_addresses(arrays), *numbers))
    session: Any = device.session
    session.run_groups(kernel.entry, launch, columns * rows, LEAST_GROUPS, used)
    check_rays_here(device.world, batch, piece, rays.bad)


# What kernels of the host are told of rays, in the order of their arguments, and which of it are addresses.
_ARGUMENTS = (
    "origins", "directions", "t_mins", "t_maxs", "masks", "doubles", "axes", "axis_count", "ray_count", "box", "order",
    "is_by_place", "row_length", "tile_width", "tile_height", "finds_start", "bad",
)  # fmt: skip
_ADDRESSES = {"origins", "directions", "t_mins", "t_maxs", "masks", "axes", "box", "order", "bad"}


class HostRays(NamedTuple):
    """What kernels of the host are told of rays.

    Attributes
    ----------
    numbers : tuple of int
        Addresses and numbers, see cl/on_host/world/rays.cl.
    work_size : (int, int)
        Columns and rows of tiles.
    bad : (1,) int32
        Where a kernel writes which ray is bad.
    used : tuple
        Arrays that have to be kept.
    """

    numbers: tuple[int, ...]
    work_size: tuple[int, int]
    bad: NDArray[np.int32]
    used: tuple[Any, ...]

    def as_arguments(self) -> dict[str, int]:
        """Return the numbers by the names of the kernels' arguments."""
        named = zip(_ARGUMENTS, self.numbers, strict=True)
        return {name: Address(number) if name in _ADDRESSES else number for name, number in named}


def describe_rays(
    settings: Settings, world: World, batch: RayBatch, piece: RayPiece, *, in_ray_order: bool = True
) -> HostRays:
    """Return what kernels of the host are told of the rays of a piece; see `put_rays`."""
    row_length, order = piece.row_length, piece.order
    count = piece.end - piece.begin if order is None else len(order)
    if row_length:
        width, height = settings.tile
    else:
        row_length, width, height = count, settings.work_group_size, 1
    axes, bad = batch.axes(), _ALL_GOOD.copy()
    if piece.begin:
        axes = axes.copy()
        axes[0, 0] = piece.begin
    # Kernels read the user's arrays with any strides.
    used = *batch.arrays, axes, world.box_numbers, order, bad
    origins, directions, t_mins, t_maxs, masks, axes_at, box, order_at, bad_at = find_addresses(used)
    numbers = (
        origins, directions, t_mins, t_maxs, masks, batch.doubles, axes_at, len(axes) - 2, count, box, order_at,
        not in_ray_order, row_length, width, height, piece.is_coherent and world.has_entry_points, bad_at,
    )  # fmt: skip
    return HostRays(numbers, (-(-row_length // width), -(-count // (row_length * height))), bad, used)


def check_rays_here(world: World, batch: RayBatch, piece: RayPiece, bad: NDArray[np.int32]) -> None:
    """Raise for the first bad ray of the piece's chunk, if a kernel has met one."""
    if bad[0] != _NO_RAY:
        if piece.order is not None:
            # Pieces before this one had other rays.
            check_rays(batch, world.box, piece.begin, piece.begin + int(bad[0]))
        raise explain_bad_ray(batch, piece.begin + int(bad[0]))
