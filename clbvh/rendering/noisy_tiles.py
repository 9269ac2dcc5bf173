"""Samples where a picture is noisy: the tiles of a film, and which of them need no more; see `View.noise`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..device.program import build_kernels
from ..structs import CELL_PIXELS, SETTLING_SAMPLES
from .band import Band


class NoisyTiles:
    """The tiles of a film by cells, which get samples until their noise is small; see cl/kernels/settle_tiles.cl.

    Parameters
    ----------
    band : Band
    cells : buffer
        The film.
    size, tile : (int, int)
        Columns and rows of the film, and of a tile.
    noise : float
        As in `Progress`.

    Attributes
    ----------
    end : int
        Samples at the end of the pass.
    settled : buffer
        The argument of `render_samples`.
    """

    def __init__(self, band: Band, cells: Any, size: tuple[int, int], tile: tuple[int, int], noise: float) -> None:
        self._band, self._cells, self._noise = band, cells, np.float32(noise)
        self._tile = dict(zip(("tile_width", "tile_height"), map(np.int32, tile), strict=True))
        self._passes = np.zeros([-(-size[axis] // tile[axis]) for axis in (1, 0)], np.int32)
        self._kernels = build_kernels(band.memory.session, "settle_tiles")
        self._lights = band.take("lights", 4 * size[0] * size[1])
        self.settled = band.take("settled", self._passes.nbytes)
        band.memory.session.write(self.settled, self._passes)
        self._pass, self.end = 0, SETTLING_SAMPLES

    def end_pass(self) -> bool:
        """Find the tiles that are settled, and begin another pass; return whether none needs it."""
        band, session = self._band, self._band.memory.session
        band.run(
            self._kernels["settle_tiles"], self._passes.shape[::-1], (1, 1), cells=self._cells, view=band.view,
            row_count=np.int32(band.row_count), noise=self._noise, **{"pass": np.int32(self._pass)}, **self._tile,
            lights=self._lights, settled=self.settled,
        )  # fmt: skip
        session.download(self.settled, self._passes)
        self._pass, self.end = self._pass + 1, 2 * self.end
        return bool(self._passes.all())

    def weigh(self, taken: int) -> dict[str, Any]:
        """Return the arguments of `join_cells` that say how many samples each cell has."""
        rows, count = self._pass + 1, np.int32(taken)
        weights = self._band.take("weights", 4 * CELL_PIXELS * rows)
        self._band.run(self._kernels["weigh_samples"], (rows, 1), (1, 1), sample_count=count, weights=weights)
        return {"settled": self.settled, "weights": weights, "sample_count": count, **self._tile}

    def mean_samples(self, taken: int) -> int:
        """Return the samples of a cell in the mean; those that are not settled have this many."""
        return round(float(np.where(self._passes, SETTLING_SAMPLES << self._passes, taken).mean()))


# Arguments of `join_cells` where all cells have the same samples.
ALL_ALIKE: dict[str, Any] = {"settled": None, "weights": None}
ALL_ALIKE |= dict.fromkeys(("tile_width", "tile_height", "sample_count"), np.int32(1))
