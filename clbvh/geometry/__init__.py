"""Shapes in memory: meshes, spheres, boxes, materials; mesh files, procedural shapes. Knows nothing of trees."""

from .as_mesh import MeshLike, as_mesh
from .fetch import find_known_mesh
from .loading.load import load_mesh
from .mesh import Mesh, Part
from .shapes.make_shape import make_shape
from .spheres import Shape, Spheres

__all__ = ["Mesh", "MeshLike", "Part", "Shape", "Spheres", "as_mesh", "find_known_mesh", "load_mesh", "make_shape"]
