"""Meshes in memory: the data, the files they come from, and the shapes that need no file."""

from .known import find_known_mesh
from .load import load_mesh
from .mesh import Mesh
from .shapes import make_shape

__all__ = ["Mesh", "find_known_mesh", "load_mesh", "make_shape"]
