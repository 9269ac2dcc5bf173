"""How far a picture is: what its painters are told, and what they tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

# Time of one launch, by default: a picture can be stopped between launches.
LAUNCH_S = 0.25


@dataclass
class Progress:
    """How far a picture is, and whether it is to be stopped.

    Attributes
    ----------
    samples : int
        Of each pixel, to be taken.
    time_limit_s : float
        No further samples are begun after it; each pixel gets one at least. Bands share it by their rows.
    is_stopped : function
        Asked after each launch; if it returns True, no further samples are taken.
    of_bands : dict of int to int
        Samples of each pixel that were taken, in the mean, by the first row of the band.
    film : (height, width, 4) float32, or None
        Is filled with the means of the samples: linear red, green and blue, and the share that is covered.
    is_apart : bool
        Whether the pixels of ``"path"`` share no samples, so that the noise of each is its own; see `denoise`.
    noise : float
        Tiles of ``"path"`` with less noise than this get no more samples; 0: all get the same. See `View.noise`.
    launch_s : float
        Time of one launch, at about which the next number of samples is chosen.
    on_samples : function
        Called after each launch with the samples that are done, of all pixels together, and that all are to get.
    """

    samples: int
    time_limit_s: float = np.inf
    is_stopped: Callable[[], bool] = lambda: False
    of_bands: dict[int, int] = field(default_factory=dict)
    film: NDArray[np.float32] | None = None
    is_apart: bool = False
    noise: float = 0.0
    launch_s: float = LAUNCH_S
    on_samples: Callable[[int, int], object] = lambda done, all_of_them: None

    @property
    def taken(self) -> int:
        """Samples of each pixel that were taken, in the mean; of several bands, those of the band with the fewest."""
        return min(self.of_bands.values(), default=1)

    def show(self, rows: float, height: int, width: int) -> None:
        """Tell the user how many rows, or parts of rows, are done of a picture."""
        self.on_samples(round(rows * width * self.samples), height * width * self.samples)
