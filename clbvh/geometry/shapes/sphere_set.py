"""Procedural spheres with the materials that they have, if any."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..appearance.material import Material


class SphereSet(NamedTuple):
    """Spheres as arrays.

    Attributes
    ----------
    centres : (n, 3) float64
    radii : (n,) float64
    materials : tuple of Material
        Empty: the spheres have none.
    material_ids : (n,) int32, or None
    """

    centres: NDArray[np.float64]
    radii: NDArray[np.float64]
    materials: tuple[Material, ...] = ()
    material_ids: NDArray[np.int32] | None = None
