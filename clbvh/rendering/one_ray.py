"""The shadings of the report: one ray through the centre of each pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..device.program import build_kernel
from ..device.session import DeviceSession
from ..trace.traced_tree import TracedTree
from .frame import Band
from .view_entry_points import ViewEntryPoints
from .world_arguments import world_arguments


class OneRayPainter:
    """Casts one ray for each pixel, and colours what it hits; see cl/kernels/render.cl.

    Parameters
    ----------
    session : DeviceSession
    tree : DeviceTree or DeviceScene
    tile : (int, int), optional
        Columns and rows of a work-group; by default those of the device's settings.
    colours : (n, 3) float, optional
        Linear colours of the instances; NaN, and by default: that of the view.
    has_cut : bool
        Whether the views have a cut.
    has_wireframe : bool
        Whether they have lines.

    Raises
    ------
    KernelBuildError
        The device's compiler refuses the kernel.
    """

    def __init__(
        self,
        session: DeviceSession,
        tree: TracedTree,
        tile: tuple[int, int] | None = None,
        colours: NDArray[np.floating] | None = None,
        *,
        has_cut: bool = False,
        has_wireframe: bool = False,
    ) -> None:
        own = np.full((1, 3), np.nan) if colours is None else colours
        has_own = ~np.isnan(own).any(axis=1, keepdims=True)
        rows = np.concatenate((np.where(has_own, own, 0.0), has_own), axis=1).astype(np.float32)
        self._arguments = world_arguments(tree) | {"instance_colours": session.upload(rows)}
        self._tile = tile or session.settings.tile
        self._kernel = build_kernel(
            session, "render", {**tree.defines, "HAS_CUT": int(has_cut), "HAS_WIREFRAME": int(has_wireframe)}
        )
        self._entry_points = ViewEntryPoints(session, tree, self._tile, 0.0)

    @property
    def pixel_bytes(self) -> int:
        """Bytes of the largest buffer for each pixel, beside those of the band."""
        return 0

    def paint(self, band: Band) -> None:
        """Fill the colours and the hits of a band."""
        band.session.run(
            self._kernel, (band.width, band.row_count), self._tile, **self._arguments, **self._entry_points.find(band),
            **band.rows, colours=band.colours, hits=band.hits,
        )  # fmt: skip
