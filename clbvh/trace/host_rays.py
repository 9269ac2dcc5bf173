"""Rays on the host: one kernel reads the user's arrays, casts, refines, and writes the answers where they are wanted.

See cl/on_host/world/rays.cl.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..device.host.library import HostKernel, find_addresses
from ..device.host.session import LEAST_GROUPS
from ..device.settings import Settings
from .rays.batch import RayBatch
from .rays.pack import check_rays, explain_bad_ray
from .rays.pieces import RayPiece
from .world.tree_box import TreeBox
from .world.world import World

# The number of the first bad ray, where none is.
_NO_RAY = np.iinfo(np.int32).max
_ALL_GOOD = np.array([_NO_RAY], np.int32)


class HostRays(NamedTuple):
    """The rays of a piece as kernels of the host are told of them.

    Attributes
    ----------
    batch : RayBatch
    piece : RayPiece
        Of the batch; it has rays.
    box : TreeBox
    numbers : tuple of int
        Addresses and numbers in the order of the kernels' arguments, see cl/on_host/world/rays.cl.
    work_size : (int, int)
        Columns and rows of tiles.
    bad : (1,) int32
        Where a kernel writes which ray is bad.
    used : tuple
        Arrays that have to be kept.
    refuses_bad : bool
        Whether a bad ray is an error. A kernel casts it as one that hits nothing.
    """

    batch: RayBatch
    piece: RayPiece
    box: TreeBox
    numbers: tuple[int, ...]
    work_size: tuple[int, int]
    bad: NDArray[np.int32]
    used: tuple[Any, ...]
    refuses_bad: bool = True

    @classmethod
    def of_piece(
        cls, settings: Settings, world: World, batch: RayBatch, piece: RayPiece, *, in_ray_order: bool = True
    ) -> HostRays:
        """Return the rays of a piece; see `put_rays`."""
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
        tiles = -(-row_length // width), -(-count // (row_length * height))
        return cls(batch, piece, world.box, numbers, tiles, bad, used)

    def cast(self, session: Any, kernel: HostKernel, arrays: Iterable[NDArray[Any] | None], *numbers: int) -> None:
        """Cast the rays.

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
            As `pack_rays`, for the first bad ray of the piece's chunk that the kernel has met.
        InternalError
            A buffer of the world was given back, which cannot be while a call is open.
        """
        # Another thread may give the buffers back from here on: what is held stays.
        used = kernel.hold()
        columns, rows = self.work_size
        launch = kernel.bind_numbers((columns, rows, 1, 1), (*self.numbers, *find_addresses(arrays), *numbers))
        session.run_groups(kernel.entry, launch, columns * rows, LEAST_GROUPS, used)
        if self.bad[0] != _NO_RAY and self.refuses_bad:
            self._raise()

    def _raise(self) -> None:
        begin, bad = self.piece.begin, self.piece.begin + int(self.bad[0])
        if self.piece.order is not None:
            # Pieces before this one had other rays.
            check_rays(self.batch, self.box, begin, bad)
        raise explain_bad_ray(self.batch, bad)
