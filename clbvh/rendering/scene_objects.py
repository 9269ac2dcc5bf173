"""The objects of a scene as a picture keeps them: their surfaces, and the trees in which rays found them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..bvh import Bvh
from ..geometry import Mesh
from ..scene.state import SceneState
from ..trace.hits.surface import SceneSurface
from ..trace.scene.merging import Merging


@dataclass(frozen=True, eq=False, repr=False)
class SceneObjects:
    """The objects of a scene at the moment at which its renderer was made.

    Attributes
    ----------
    state : SceneState
    surface : SceneSurface
        What hits are refined on.
    trees : tuple of Bvh or None
        One for each geometry, None for one whose instances are merged; none with the builder ``"brute"``.
    top : Bvh
        The tree over the instances, and over the merged meshes.
    merging : Merging
    """

    state: SceneState
    surface: SceneSurface
    trees: tuple[Bvh | None, ...]
    top: Bvh
    merging: Merging

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
        shapes, trees = self.state.shapes, self.merging.list_trees(self.trees)
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
            "nodes": self.top.node_count + sum(bvh.node_count for bvh in trees),
            "depth": self.top.depth + max((bvh.depth for bvh in trees), default=0),
            "sah_cost": None,
        }
