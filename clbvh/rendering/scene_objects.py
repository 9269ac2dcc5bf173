"""The objects of a scene as a picture keeps them: their surfaces, and the trees in which rays found them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..bvh import Bvh
from ..geometry import Mesh
from ..scene.state import SceneState
from ..trace.hits.surface import SceneSurface


@dataclass(frozen=True, eq=False, repr=False)
class SceneObjects:
    """The objects of a scene at the moment at which its renderer was made.

    Attributes
    ----------
    state : SceneState
    surface : SceneSurface
        What hits are refined on.
    trees : tuple of Bvh
        One for each geometry; none with the builder ``"brute"``.
    top : Bvh
        The tree over the instances; its primitives are their ids.
    """

    state: SceneState
    surface: SceneSurface
    trees: tuple[Bvh, ...]
    top: Bvh

    @property
    def instance_count(self) -> int:
        """Number of instances."""
        return self.state.instance_count

    @property
    def name(self) -> str:
        """The name of the only geometry, or the number of instances."""
        names = self.state.names
        return names[0] if len(names) == 1 else f"{self.instance_count:,} instances"

    def report(self) -> dict[str, Any]:
        """Return the numbers of objects and trees, for `Picture.report`.

        Triangles, spheres and nodes are those in memory, each geometry once; the depth is the greatest of both levels
        together.
        """
        shapes = self.state.shapes
        meshes = [shape for shape in shapes if isinstance(shape, Mesh)]
        prim_counts = np.array([shape.prim_count for shape in shapes], np.int64)
        face_count = sum(mesh.face_count for mesh in meshes)
        return {
            "mesh": self.name,
            "triangles": face_count,
            "degenerate_triangles": sum(mesh.degenerate_count for mesh in meshes),
            "spheres": int(prim_counts.sum()) - face_count,
            "geometries": len(shapes),
            "instances": self.instance_count,
            "placed_primitives": int(prim_counts[self.state.geometry_ids].sum()),
            "nodes": self.top.node_count + sum(bvh.node_count for bvh in self.trees),
            "depth": self.top.depth + max((bvh.depth for bvh in self.trees), default=0),
            "sah_cost": None,
        }
