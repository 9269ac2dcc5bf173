"""The shapes that a geometry may have."""

from __future__ import annotations

from typing import TypeAlias

from .mesh import Mesh
from .spheres import Spheres

Shape: TypeAlias = Mesh | Spheres
"""The shape of a geometry: a triangle mesh, or spheres. Both have `prim_count`, `origin`, `scale` and `fingerprint`."""
