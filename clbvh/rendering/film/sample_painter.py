"""Shadings with samples: the light of many rays a pixel is added up on a film, which is then developed."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...device.program import build_kernel
from ...device.session import DeviceSession
from ...structs import SHADINGS
from ...trace.traced_tree import TracedTree
from ..frame import Band
from ..view_entry_points import ViewEntryPoints
from ..world_arguments import world_arguments

_FILM_DTYPE = np.dtype((np.float32, 4))

# Time of one launch, at about which the next number of samples is chosen: a picture can be stopped between launches.
_LAUNCH_S = 0.25

# A launch takes a multiple of it, but for the last one: the samples of a pair share work, see cl/film/studio.cl.
_LEAST_SAMPLES = 2

# Pixels around the centre of a pixel in which its samples are, see cl/film/pixel.cl.
_FILTER_RADIUS = 1.0

# Arguments of `render_samples` that only paths have.
_NO_LIGHTS: dict[str, Any] = dict.fromkeys(
    ("lights", "light_shares", "environment", "environment_rows", "environment_columns")
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
    arguments : mapping of str to argument
        The tables of cl/looks/, and those of the light of ``"path"``.
    has_cutouts : bool
        Whether rays may pass through surfaces.
    has_cut : bool
        Whether the views have a cut.

    Raises
    ------
    KernelBuildError
        The device's compiler refuses a kernel.
    """

    def __init__(
        self,
        session: DeviceSession,
        tree: TracedTree,
        shading: str,
        arguments: Mapping[str, Any],
        *,
        has_cutouts: bool,
        has_cut: bool = False,
    ) -> None:
        self.tree = tree
        self.tile = session.settings.tile
        self.arguments = {**world_arguments(tree), **_NO_LIGHTS, **arguments}
        defines = {
            **tree.defines,
            "SHADING": SHADINGS[shading],
            "HAS_CUTOUTS": int(has_cutouts),
            "HAS_CUT": int(has_cut),
        }
        self.kernel = build_kernel(session, "render_samples", defines)
        self.develop = build_kernel(session, "develop")
        self.entry_points = ViewEntryPoints(session, tree, self.tile, _FILTER_RADIUS)


class SamplePainter:
    """Takes the samples of one picture.

    Parameters
    ----------
    shading : SampleShading
    progress : Progress
    arguments : mapping of str to argument
        Of this picture alone: the environment.
    """

    def __init__(
        self, shading: SampleShading, progress: Progress, arguments: Mapping[str, Any] = MappingProxyType({})
    ) -> None:
        self._shading, self._progress, self._arguments = shading, progress, arguments
        self._begin = time.perf_counter()

    def paint(self, band: Band) -> None:
        """Fill the colours and the hits of a band."""
        shading, session = self._shading, band.session
        pixel_count = band.width * band.row_count
        film = band.memory.buffer("film", for_mapping=False).take(pixel_count * _FILM_DTYPE.itemsize)
        arguments = {**shading.arguments, **self._arguments, **band.rows, **shading.entry_points.find(band)}
        taken = self._take_samples(band, film, arguments)
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

    def _take_samples(self, band: Band, film: Any, arguments: dict[str, Any]) -> int:
        """Add samples to the film; return how many of each pixel."""
        progress = self._progress
        first, count = 0, min(_LEAST_SAMPLES, progress.samples)
        pixels, done = band.width * band.height, band.width * band.first_row
        end_s = self._begin + progress.time_limit_s * (band.first_row + band.row_count) / band.height
        while True:
            begin = time.perf_counter()
            band.session.run(
                self._shading.kernel, (band.width, band.row_count), self._shading.tile, **arguments,
                first_sample=np.int32(first), sample_count=np.int32(count), film=film, hits=band.hits,
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
