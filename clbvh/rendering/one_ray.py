"""The shadings of the report: one ray through the centre of each pixel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..device.program import build_kernel
from ..device.session import DeviceSession
from ..trace.traced_tree import TracedTree
from .frame import Band
from .view_entry_points import ViewEntryPoints


class OneRayPainter:
    """Casts one ray for each pixel, and colours what it hits; see cl/kernels/render.cl.

    Parameters
    ----------
    session : DeviceSession
    tree : DeviceTree or DeviceScene
    tile : (int, int), optional
        Columns and rows of a work-group; by default those of the device's settings.
    arguments : mapping of str to argument, optional
        Arguments of the kernel beside those of the tree: for a scene, the buffer `instance_colours`.

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
        arguments: Mapping[str, Any] | None = None,
    ) -> None:
        self._tree = tree
        self._arguments = {**tree.arguments, **(arguments or {})}
        self._tile = tile or session.settings.tile
        name = "scene_render" if tree.has_instances else "render"
        self._kernel = build_kernel(session, name, tree.defines)
        # The kernel of scenes begins at the root.
        self._entry_points = None if tree.has_instances else ViewEntryPoints(session, tree, self._tile, 0.0)

    def paint(self, band: Band) -> None:
        """Fill the colours and the hits of a band."""
        arguments = {**self._arguments, **band.rows}
        if self._entry_points is not None:
            arguments["entry_points"] = self._entry_points.find(band)
        band.session.run(
            self._kernel, (band.width, band.row_count), self._tile, **arguments, colours=band.colours, hits=band.hits
        )
