"""Rays and points on the host: one kernel reads the user's arrays, works, and writes the answers where they are wanted.

See cl/on_host/world/rays.cl and points.cl.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..device.host.library import HostKernel, find_addresses
from ..device.host.session import LEAST_GROUPS
from ..device.settings import Settings
from .rays.batch import RayBatch
from .rays.pack import check_rays, explain_bad_ray
from .rays.pieces import Piece
from .world.tree_box import TreeBox
from .world.world import World

# The number of the first bad item, where none is.
_NO_ITEM = np.iinfo(np.int32).max
ALL_GOOD = np.array([_NO_ITEM], np.int32)


class HostItems(NamedTuple):
    """The rays or points of a piece as kernels of the host are told of them.

    Attributes
    ----------
    numbers : tuple of int
        Addresses and numbers in the order of the kernels' arguments.
    groups : (int, int, int)
        Columns and rows of work-groups, and the columns of each.
    bad : (1,) int32
        Where a kernel writes which item is bad. It works on with one that finds nothing.
    used : tuple
        Arrays that have to be kept.
    explain : function or None
        Returns the error for a bad item, given its number. None: it is none.
    """

    numbers: tuple[int, ...]
    groups: tuple[int, int, int]
    bad: NDArray[np.int32]
    used: tuple[Any, ...]
    explain: Callable[[int], Exception] | None

    @classmethod
    def of_rays(
        cls, settings: Settings, world: World, batch: RayBatch, piece: Piece, *, in_ray_order: bool = True
    ) -> HostItems:
        """Return the rays of a piece, which has some; see `put_rays`."""
        row_length, order = piece.row_length, piece.order
        count = piece.item_count
        if row_length:
            width, height = settings.tile
        else:
            row_length, width, height = count, settings.work_group_size, 1
        arrays, axes, bad = batch.arrays, begin_at(batch.axes, piece.begin), ALL_GOOD.copy()
        # Kernels read the user's arrays with any strides.
        excluded = None if batch.excluded is None else batch.excluded[piece.begin :]
        used = *arrays, axes, world.box_numbers, order, bad, excluded
        origins, directions, t_mins, t_maxs, masks, axes_at, box, order_at, bad_at, excluded_at = find_addresses(used)
        numbers = (
            origins, directions, t_mins, t_maxs, masks, batch.doubles, axes_at, len(axes) - 2, count, box, order_at,
            not in_ray_order, row_length, width, height, piece.is_coherent and world.has_entry_points, bad_at,
            batch.side, excluded_at,
        )  # fmt: skip
        tiles = -(-row_length // width), -(-count // (row_length * height)), 1
        return cls(numbers, tiles, bad, used, partial(_explain_ray, batch, piece, world.box))

    def run(self, session: Any, kernel: HostKernel, arrays: Iterable[NDArray[Any] | None], *numbers: int) -> None:
        """Run a kernel.

        Parameters
        ----------
        session : HostSession
        kernel : HostKernel
            That is told of the world.
        arrays : iterable of array or None
            The kernel's own arguments, in their order: what it writes and reads, contiguous.
        *numbers
            Those behind them.

        Raises
        ------
        QueryError
            For the first bad item of the piece's chunk that the kernel has met.
        InternalError
            A buffer of the world was given back, which cannot be while a call is open.
        """
        # Another thread may give the buffers back from here on: what is held stays.
        used = kernel.hold()
        columns, rows, size = self.groups
        launch = kernel.bind_numbers((columns, rows, size, 1), (*self.numbers, *find_addresses(arrays), *numbers))
        session.run_groups(kernel.entry, launch, columns * rows, LEAST_GROUPS, used)
        if self.bad[0] != _NO_ITEM and self.explain is not None:
            raise self.explain(int(self.bad[0]))


def begin_at(axes: NDArray[np.int64], begin: int) -> NDArray[np.int64]:
    """Return the axes of items from one on, see cl/rays/arrays.cl."""
    if begin:
        axes = axes.copy()
        axes[0, 0] = begin
    return axes


def _explain_ray(batch: RayBatch, piece: Piece, box: TreeBox, bad: int) -> Exception:
    if piece.order is not None:
        # Pieces before this one had other rays.
        check_rays(batch, box, piece.begin, piece.begin + bad)
    return explain_bad_ray(batch, piece.begin + bad)
