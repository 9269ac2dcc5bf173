"""Meshes in memory: the data, the files they come from, and the shapes that need no file."""

from .load import load_mesh
from .mesh import Mesh

__all__ = ["Mesh", "load_mesh"]
