"""Meshes in memory: the data, the files they are loaded from, and procedural shapes. Knows nothing of trees."""

from .as_mesh import MeshLike, as_mesh
from .fetch import find_known_mesh
from .loading.load import load_mesh
from .mesh import Mesh
from .shapes.make_shape import make_shape

__all__ = ["Mesh", "MeshLike", "as_mesh", "find_known_mesh", "load_mesh", "make_shape"]
