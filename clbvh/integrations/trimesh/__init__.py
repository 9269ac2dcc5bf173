"""The engine for trimesh: rays, of scenes too, proximity, both as the default of every mesh, and collisions.

Names, arguments, defaults, orders and dtypes are those of trimesh 5: of ``ray_pyembree.RayMeshIntersector`` and of the
module ``trimesh.proximity``. See docs/trimesh.md.
"""

from .collision import CollisionManager
from .install import Installation, install, is_installed, uninstall
from .proximity import ProximityQuery, closest_point, signed_distance
from .ray import RayMeshIntersector, SceneRay
from .thickness import longest_ray, max_tangent_sphere, reach, thickness

__all__ = [
    "CollisionManager",
    "Installation",
    "ProximityQuery",
    "RayMeshIntersector",
    "SceneRay",
    "closest_point",
    "install",
    "is_installed",
    "longest_ray",
    "max_tangent_sphere",
    "reach",
    "signed_distance",
    "thickness",
    "uninstall",
]
