"""One object of a scene file: its source, its placement and its copies, checked, and not loaded yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.appearance.material import Material
from .repeat import Grid, Scatter
from .scene import MeshSource
from .spheres_source import SpheresSource
from .vectors import Vector

ALL_BITS = 2**32 - 1  # of a mask: visible for every ray


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A mesh or spheres, placed in a scene once or many times.

    Attributes
    ----------
    label : str
        Of this object alone.
    source : MeshSource or SpheresSource
    matrix : (4, 4) float64
        From the source's coordinates to the scene's; of each copy before the copy itself is moved.
    repeat : Grid, Scatter or None
    colour : (3,) float, or None
        Linear. None: the scene's `surface`.
    material : Material, or None
        None: those of the source.
    mask : int
        32 bits: rays see the object whose mask has a bit of it.
    """

    label: str
    source: MeshSource | SpheresSource
    matrix: NDArray[np.float64]
    repeat: Grid | Scatter | None = None
    colour: Vector | None = None
    mask: int = ALL_BITS
    material: Material | None = None

    @property
    def count(self) -> int:
        """The number of copies."""
        return 1 if self.repeat is None else self.repeat.count
