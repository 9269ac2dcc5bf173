"""The painters of a band: one ray through the centre of each pixel, or samples that are added up on a film."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..choices import SHADINGS
from ..device.program import build_kernel
from ..device.session import DeviceSession
from ..structs import CELL_PIXELS
from ..trace.traced_tree import TracedTree, find_entry_points
from .frame import Band

# Those that a mesh without a scene, or a scene, has none of.
_NONE: dict[str, Any] = {"top_nodes": None, "instances": None, "spheres": None, "block_count": np.int32(0)}


def world_arguments(tree: TracedTree) -> dict[str, Any]:
    """Return the arguments by their names."""
    return _NONE | tree.arguments


_KERNEL = "view_entry_points"

# Macros of kernels for views without a cut and without lines.
NO_PARTS = {"HAS_CUT": 0, "HAS_WIREFRAME": 0}

# The arguments of rays that begin at the root.
AT_THE_ROOT: dict[str, Any] = {"tiles": None, "entry_points": None}


class ViewEntryPoints:
    """Finds the entry points of a camera's rays.

    Parameters
    ----------
    session : DeviceSession
    tree : DeviceTree or DeviceScene
    tile : (int, int)
        Columns and rows of the work-groups that cast the rays.
    margin : float
        Pixels around the centre of each pixel in which its rays are.
    """

    def __init__(self, session: DeviceSession, tree: TracedTree, tile: tuple[int, int], margin: float) -> None:
        self._tree, self._tile, self._margin = tree, tile, np.float32(margin)
        self._kernel = build_kernel(session, _KERNEL, tree.defines) if tree.has_entry_points else None

    def find(self, band: Band) -> dict[str, Any]:
        """Return the arguments of kernels that say where the rays of a band begin, by their names."""
        if self._kernel is None:
            return AT_THE_ROOT
        has_instances = self._tree.has_instances
        others = {} if has_instances else {"top_nodes": None, "instances": None, "tiles": None}
        starts = find_entry_points(
            band.session, self._tree, self._kernel, band.memory.buffer("entry points", for_mapping=False),
            (band.width, band.row_count), self._tile, margin=self._margin,
            tile_buffer=band.memory.buffer("tiles", for_mapping=False) if has_instances else None,
            **others, **band.rows,
        )  # fmt: skip
        return AT_THE_ROOT | starts


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
    parts : mapping of str to int
        Macros of the parts of the kernel that views need, as `NO_PARTS`.

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
        parts: Mapping[str, int] = NO_PARTS,
    ) -> None:
        own = np.full((1, 3), np.nan) if colours is None else colours
        has_own = ~np.isnan(own).any(axis=1, keepdims=True)
        rows = np.concatenate((np.where(has_own, own, 0.0), has_own), axis=1).astype(np.float32)
        self._arguments = world_arguments(tree) | {"instance_colours": session.upload(rows)}
        self._tile = tile or session.settings.tile
        self._kernel = build_kernel(session, "render", {**tree.defines, **parts})
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


# The kernel that makes colours of the film; it knows no tree.
DEVELOP = "develop"

_FILM_DTYPE = np.dtype((np.float32, 4))

# Time of one launch, at about which the next number of samples is chosen: a picture can be stopped between launches.
_LAUNCH_S = 0.25

# A launch takes a multiple of it, but for the last one: the samples of a pair share work, see cl/film/studio.cl.
_LEAST_SAMPLES = 2

# Pixels around the centre of a pixel in which its samples are, see cl/film/pixel.cl.
_FILTER_RADIUS = 1.0

# Arguments of `render_samples` that only paths have.
_NO_LIGHTS: dict[str, Any] = dict.fromkeys(
    ("lights", "light_choices", "environment", "environment_rows", "environment_columns")
)


@dataclass
class Progress:
    """How far a picture is, and whether it is to be stopped.

    Attributes
    ----------
    samples : int
        Of each pixel, to be taken.
    time_limit_s : float
        No further samples are begun after it; each pixel gets one at least. Bands share it by their rows.
    on_samples : function
        Called with the samples taken so far and those to be taken, summed over all pixels.
    is_stopped : function
        Asked after each launch; if it returns True, no further samples are taken.
    taken : int
        Samples of each pixel that were taken; of a picture in several bands, those of the band with the fewest.
    film : (height, width, 4) float32, or None
        Is filled with the means of the samples: linear red, green and blue, and the share that is covered.
    """

    samples: int
    time_limit_s: float = np.inf
    on_samples: Callable[[int, int], None] = lambda done, total: None
    is_stopped: Callable[[], bool] = lambda: False
    taken: int = 0
    film: NDArray[np.float32] | None = None


class SampleShading:
    """One of the shadings with samples, compiled for a tree or a scene.

    Parameters
    ----------
    session : DeviceSession
    tree : DeviceTree or DeviceScene
    shading : str
        ``"studio"``, ``"ao"`` or ``"path"``.
    parts : mapping of str to int
        Macros of the parts of the kernel that views need: those of `NO_PARTS`, and HAS_CUTOUTS, HAS_NORMAL_MAPS and
        HAS_GROUND.

    Attributes
    ----------
    join_cells : Kernel or None
        Makes pixels of the film's cells; None where the film is one by pixels.

    Raises
    ------
    KernelBuildError
        The device's compiler refuses a kernel.
    """

    def __init__(self, session: DeviceSession, tree: TracedTree, shading: str, parts: Mapping[str, int]) -> None:
        self.tree = tree
        self.tile = session.settings.tile
        self.arguments = {**world_arguments(tree), **_NO_LIGHTS}
        defines = {**tree.defines, "SHADING": SHADINGS[shading], **parts}
        self.kernel = build_kernel(session, "render_samples", defines)
        self.develop = build_kernel(session, DEVELOP)
        self.join_cells = build_kernel(session, "join_cells") if shading == "path" else None
        self.entry_points = ViewEntryPoints(session, tree, self.tile, _FILTER_RADIUS)


class SamplePainter:
    """Takes the samples of one picture.

    Parameters
    ----------
    shading : SampleShading
    progress : Progress
    arguments : mapping of str to argument
        The tables of cl/looks/, and those of the light and the environment of ``"path"``.
    """

    def __init__(self, shading: SampleShading, progress: Progress, arguments: Mapping[str, Any]) -> None:
        self._shading, self._progress, self._arguments = shading, progress, arguments
        self._begin = time.perf_counter()

    @property
    def pixel_bytes(self) -> int:
        """Bytes of the largest buffer for each pixel, beside those of the band."""
        return _FILM_DTYPE.itemsize * (CELL_PIXELS if self._shading.join_cells else 1)

    def paint(self, band: Band) -> None:
        """Fill the colours and the hits of a band."""
        shading, session = self._shading, band.session
        film = _take_film(band, "film", band.width, band.row_count)
        arguments = {**shading.arguments, **self._arguments, **band.rows}
        if shading.join_cells:
            # Cells are not the tiles of pixels for which entry points are found: their rays begin at the root.
            size = band.width + 2, band.row_count + 2
            cells = _take_film(band, "cells", CELL_PIXELS * size[0], size[1])
            taken = self._take_samples(band, size, {**arguments, **AT_THE_ROOT, "film": cells})
            session.run(
                shading.join_cells, (band.width, band.row_count), shading.tile,
                cells=cells, width=np.int32(band.width), row_count=np.int32(band.row_count), film=film,
            )  # fmt: skip
        else:
            size = band.width, band.row_count
            taken = self._take_samples(band, size, {**arguments, **shading.entry_points.find(band), "film": film})
        session.run(
            shading.develop, (band.width, band.row_count), shading.tile,
            film=film, row_count=np.int32(band.row_count), sample_count=np.int32(taken), view=band.view,
            colours=band.colours,
        )  # fmt: skip
        self._progress.taken = taken if band.first_row == 0 else min(taken, self._progress.taken)
        if (kept := self._progress.film) is not None:
            rows = kept[band.first_row : band.first_row + band.row_count]
            session.download(film, rows)
            rows /= np.float32(taken)

    def _take_samples(self, band: Band, size: tuple[int, int], arguments: dict[str, Any]) -> int:
        """Add samples to the film, with this many work-items; return how many of each pixel."""
        progress = self._progress
        first, count = 0, min(_LEAST_SAMPLES, progress.samples)
        pixels, done = band.width * band.height, band.width * band.first_row
        end_s = self._begin + progress.time_limit_s * (band.first_row + band.row_count) / band.height
        while True:
            begin = time.perf_counter()
            band.session.run(
                self._shading.kernel, size, self._shading.tile, **arguments,
                first_sample=np.int32(first), sample_count=np.int32(count), hits=band.hits,
            )  # fmt: skip
            band.session.finish()
            now = time.perf_counter()
            first += count
            progress.on_samples(
                done * progress.samples + band.width * band.row_count * first, pixels * progress.samples
            )
            if first >= progress.samples or progress.is_stopped() or now > end_s:
                return first
            fitting = int(_LAUNCH_S * count / max(now - begin, 1e-9)) // _LEAST_SAMPLES * _LEAST_SAMPLES
            count = min(progress.samples - first, max(_LEAST_SAMPLES, fitting))


def _take_film(band: Band, name: str, width: int, row_count: int) -> Any:
    """Return a buffer of float4 for a band."""
    return band.memory.buffer(name, for_mapping=False).take(width * row_count * _FILM_DTYPE.itemsize)
