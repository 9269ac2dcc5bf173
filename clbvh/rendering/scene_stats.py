"""Both levels of a scene as numbers: the tree of each geometry, and the tree over the instances.

No device takes part: the boxes of the instances are those that a tracer builds its tree over.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..builders.build import build
from ..bvh.bvh import Bvh, sah_cost
from ..errors import SceneError
from ..geometry.box_mesh import box_mesh, mesh_of
from ..geometry.mesh import Mesh
from ..layouts.device_arrays import measure_device_bytes
from ..scene.state import SceneState
from ..structs import BVH2_NODE, INSTANCE, LAYOUT_WIDTHS
from ..trace.hits.scene_arrays import make_scene_arrays
from ..trace.scene.top_tree import find_boxes


@dataclass(frozen=True)
class GeometryStats:
    """The tree of one geometry.

    Attributes
    ----------
    name : str
    kind : str
        ``triangles`` or ``spheres``.
    prim_count, instance_count, node_count : int
    depth : int
        Edges from the root to the deepest leaf.
    sah_cost : float
        See `clbvh.sah_cost`.
    host_bytes : int
        Of the tree, without the geometry.
    device_bytes : mapping of str to int
        By layout: nodes and blocks of primitives.
    """

    name: str
    kind: str
    prim_count: int
    instance_count: int
    node_count: int
    depth: int
    sah_cost: float
    host_bytes: int
    device_bytes: Mapping[str, int]


@dataclass(frozen=True)
class TopStats:
    """The tree over the instances, which has the layout `bvh2` on every device.

    Attributes
    ----------
    instance_count, node_count : int
    depth : int
    sah_cost : float
        In which entering an instance costs as much as a primitive test.
    device_bytes : int
        Nodes and instances.
    """

    instance_count: int
    node_count: int
    depth: int
    sah_cost: float
    device_bytes: int

    @property
    def device_bytes_per_instance(self) -> float:
        """`device_bytes` over the number of instances."""
        return self.device_bytes / self.instance_count


@dataclass(frozen=True)
class SceneStats:
    """Both levels of a scene.

    Attributes
    ----------
    geometries : tuple of GeometryStats
        By geometry id.
    top : TopStats
    prim_count : int
        Of all instances.
    lower, upper : (3,) float
        Corners of the box around the scene.
    """

    geometries: tuple[GeometryStats, ...]
    top: TopStats
    prim_count: int
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    @property
    def device_bytes(self) -> dict[str, int]:
        """Both levels, by the layout of the geometries' trees."""
        return {
            layout: self.top.device_bytes + sum(geometry.device_bytes[layout] for geometry in self.geometries)
            for layout in LAYOUT_WIDTHS
        }

    def as_dict(self) -> dict[str, Any]:
        """Return all fields and properties as types that JSON has."""
        return {
            "prim_count": self.prim_count,
            "lower": list(self.lower),
            "upper": list(self.upper),
            "device_bytes": self.device_bytes,
            "geometries": [asdict(geometry) for geometry in self.geometries],
            "instances": {**asdict(self.top), "device_bytes_per_instance": self.top.device_bytes_per_instance},
        }


def measure_scene(state: SceneState, build_tree: Callable[[Mesh], Bvh], *, traversal_cost: float = 1.0) -> SceneStats:
    """Build the trees of a scene and measure them.

    Parameters
    ----------
    state : SceneState
        At least one instance.
    build_tree : function
        Returns the tree of a geometry's mesh; of spheres it gets the mesh of their boxes.
    traversal_cost : float, optional
        Cost of an interior node, in primitive tests.

    Returns
    -------
    SceneStats

    Raises
    ------
    SceneError
        The scene is empty, or an instance is too small or too large.
    ConfigError, MeshError, PoolError
        See `clbvh.build`.
    """
    if state.instance_count == 0:
        raise SceneError("the scene is empty: it has no instance")
    placed = np.bincount(state.geometry_ids, minlength=state.geometry_count).tolist()
    geometries = []
    for name, shape, instance_count in zip(state.names, state.shapes, placed, strict=True):
        bvh = build_tree(mesh_of(shape))
        geometries.append(
            GeometryStats(
                name=name,
                kind="triangles" if isinstance(shape, Mesh) else "spheres",
                prim_count=shape.prim_count,
                instance_count=instance_count,
                node_count=bvh.node_count,
                depth=bvh.depth,
                sah_cost=sah_cost(bvh, traversal_cost=traversal_cost),
                host_bytes=bvh.nodes.nbytes + bvh.prim_ids.nbytes,
                device_bytes={layout: measure_device_bytes(bvh, layout, shape) for layout in LAYOUT_WIDTHS},
            )
        )
    lower, upper = find_boxes(make_scene_arrays(state.shapes, state.geometry_ids, state.transforms))
    # As a tracer and a renderer build it, whatever builds the others.
    top = build(box_mesh(lower, upper, "the instances"), leaf_size=1)
    return SceneStats(
        geometries=tuple(geometries),
        top=TopStats(
            instance_count=state.instance_count,
            node_count=top.node_count,
            depth=top.depth,
            sah_cost=sah_cost(top, traversal_cost=traversal_cost),
            # A tree of one leaf still has one node on the device.
            device_bytes=max(1, top.node_count // 2) * BVH2_NODE.itemsize + state.instance_count * INSTANCE.itemsize,
        ),
        prim_count=sum(geometry.prim_count * geometry.instance_count for geometry in geometries),
        lower=tuple(lower.min(axis=0).tolist()),
        upper=tuple(upper.max(axis=0).tolist()),
    )
