"""The shadings of the report: one ray through the centre of each pixel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..device.program import build_kernels
from ..device.session import DeviceSession
from ..trace.rays.entry_points import find_entry_points
from ..trace.traced_tree import TracedTree
from .frame import Band


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
        kernels = build_kernels(session, name, tree.defines)
        self._kernel = kernels[name]
        # Absent in a layout without entry points, and in scenes.
        self._entry_point_kernel = kernels.get("view_entry_points")

    def paint(self, band: Band) -> None:
        """Fill the colours and the hits of a band."""
        work_size, arguments = (band.width, band.row_count), {**self._arguments, **band.rows}
        if self._entry_point_kernel is not None:
            buffer = band.memory.buffer("entry points", for_mapping=False)
            arguments["entry_points"] = find_entry_points(
                band.session, self._tree, self._entry_point_kernel, buffer, work_size, self._tile, **band.rows
            )
        elif not self._tree.has_instances:
            arguments["entry_points"] = None
        band.session.run(self._kernel, work_size, self._tile, **arguments, colours=band.colours, hits=band.hits)
