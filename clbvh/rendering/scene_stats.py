"""Both levels of a scene as numbers: the tree of each geometry, and the tree over the instances.

No device takes part: the boxes of the instances are those that a tracer builds its tree over.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..builders.build import build_top
from ..bvh.bvh import Bvh, sah_cost
from ..errors import SceneError
from ..geometry.corners import Boxes
from ..layouts.device_arrays import make_all_arrays
from ..scene.state import SceneState
from ..structs import INSTANCE
from ..trace.world.surface_arrays import make_surface_arrays
from ..trace.world.top_tree import find_boxes, list_shown, take_instances
from ..tree_layouts import BVH2_NODE, TREE_LAYOUTS


def measure_scene(state: SceneState, trees: Sequence[Bvh], *, traversal_cost: float) -> dict[str, Any]:
    """Measure the trees of a scene.

    Parameters
    ----------
    state : SceneState
        At least one instance.
    trees : sequence of Bvh
        Over the geometries.
    traversal_cost : float
        Cost of an interior node, in primitive tests.

    Returns
    -------
    dict of str to object
        As JSON takes them: prim_count, of all instances; lower and upper, the corners of the box around the scene;
        device_bytes of both levels, by the layout of the geometries' trees; geometries, by their ids; and instances,
        the tree over them, which has the layout `bvh2` on every device, and in whose SAH cost entering an instance
        costs as much as a primitive test.

    Raises
    ------
    SceneError
        The scene is empty, or an instance is too small or too large.
    """
    if state.instance_count == 0:
        raise SceneError("the scene is empty: it has no instance")

    def describe(bvh: Bvh) -> dict[str, Any]:
        cost = sah_cost(bvh, traversal_cost=traversal_cost)
        return {"node_count": bvh.node_count, "depth": bvh.depth, "sah_cost": cost}

    placed = np.bincount(state.geometry_ids, minlength=state.geometry_count).tolist()
    device_bytes = {layout: [arrays.byte_count for arrays in make_all_arrays(trees, layout)] for layout in TREE_LAYOUTS}
    geometries = [
        {
            "name": name,
            "kind": shape.kind.name,
            "prim_count": shape.prim_count,
            "instance_count": instance_count,
            **describe(bvh),
            "host_bytes": bvh.nodes.nbytes + bvh.prim_ids.nbytes,
            "device_bytes": {layout: sizes[number] for layout, sizes in device_bytes.items()},
        }
        for number, (name, shape, bvh, instance_count) in enumerate(
            zip(state.names, state.shapes, trees, placed, strict=True)
        )
    ]
    arrays = make_surface_arrays(state.shapes, state.geometry_ids, state.transforms)
    lower, upper = find_boxes(take_instances(arrays, list_shown(state.masks)))
    # As a tracer and a renderer build it, whatever builds the others.
    top = build_top(Boxes.from_arrays(lower, upper, "the instances"))
    # A tree of one leaf still has one node on the device.
    top_bytes = max(1, top.node_count // 2) * BVH2_NODE.itemsize + len(lower) * INSTANCE.itemsize
    return {
        "prim_count": sum(each["prim_count"] * each["instance_count"] for each in geometries),
        "lower": lower.min(axis=0).tolist(),
        "upper": upper.max(axis=0).tolist(),
        "device_bytes": {
            layout: top_bytes + sum(each["device_bytes"][layout] for each in geometries) for layout in TREE_LAYOUTS
        },
        "geometries": geometries,
        "instances": {
            "instance_count": state.instance_count,
            **describe(top),
            "device_bytes": top_bytes,
            "device_bytes_per_instance": top_bytes / state.instance_count,
        },
    }
