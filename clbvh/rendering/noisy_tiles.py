"""Samples where a picture is noisy: the tiles of a film, and which of them need no more; see `View.noise`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..structs import SETTLING_SAMPLES
from .frame import Band


class NoisyTiles:
    """The tiles of cells in a band, which get samples until their noise is small; see cl/kernels/settle_tiles.cl.

    Parameters
    ----------
    band : Band
    size, tile : (int, int)
        Columns and rows of the cells, and of a tile.
    noise : float
        As in `Progress`.

    Attributes
    ----------
    end : int
        Samples at the end of the pass.
    arguments : mapping of str to argument
        What `add_samples` is told of the tiles.
    """

    def __init__(self, band: Band, size: tuple[int, int], tile: tuple[int, int], noise: float) -> None:
        self._band, self._noise, self.end = band, np.float32(noise), SETTLING_SAMPLES
        self._kernel = band.memory.session.kernel("settle_tiles")
        self._settled = np.zeros([-(-size[axis] // tile[axis]) for axis in (1, 0)], np.int32)
        cell_count = size[0] * size[1]
        self._lights = band.take("lights", 4 * cell_count)
        self._tile = {"tile_width": np.int32(tile[0]), "tile_height": np.int32(tile[1])}
        self.arguments: dict[str, Any] = self._tile | {
            "settled": band.take("settled", self._settled.nbytes),
            "sums": band.take("sums", 16 * cell_count),
            "counts": band.take("counts", 4 * band.width * band.row_count),
        }
        band.memory.session.write(self.arguments["settled"], self._settled)

    @property
    def settled_share(self) -> float:
        """The share of the tiles that get no more samples."""
        return float(np.count_nonzero(self._settled) / self._settled.size)

    def end_pass(self) -> None:
        """Find the tiles that are settled, and begin another pass."""
        band, settled = self._band, self.arguments["settled"]
        band.run(
            self._kernel, self._settled.shape[::-1], (1, 1), sums=self.arguments["sums"], view=band.view,
            row_count=np.int32(band.row_count), sample_count=np.int32(self.end), noise=self._noise,
            lights=self._lights, settled=settled, **self._tile,
        )  # fmt: skip
        band.memory.session.download(settled, self._settled)
        self.end *= 2

    def mean_samples(self, taken: int) -> int:
        """Return the samples of a cell in the mean; those that are not settled have this many."""
        return round(float(np.where(self._settled, self._settled, taken).mean()))

    def samples_of_pixels(self) -> NDArray[np.float32]:
        """Return the samples in the film of each pixel of the band, (rows, columns, 1)."""
        counts = np.empty((self._band.row_count, self._band.width, 1), np.int32)
        self._band.memory.session.download(self.arguments["counts"], counts)
        return counts.astype(np.float32)


# What `add_samples` is told where all cells have the same samples.
ALL_ALIKE: dict[str, Any] = dict.fromkeys(("settled", "sums", "counts"))
ALL_ALIKE |= {"tile_width": np.int32(1), "tile_height": np.int32(1)}
