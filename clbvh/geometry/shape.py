"""The shapes that a geometry may have."""

from __future__ import annotations

from typing import TypeAlias

from .mesh import Mesh

Shape: TypeAlias = Mesh
