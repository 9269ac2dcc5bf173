"""The tree over the instances of a scene, and their records on the device.

Everything is computed in float64 from the 4 x 4 matrices; see `structs.INSTANCE` for what is kept in float32.

Queries of points may choose any instances with each call. To build a tree over half of them takes four times as long as
to prune the tree over all; and to hide the rest there makes a point look for the chosen ones everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...device.host.loops import Loops
from ...errors import SceneError
from ...geometry.corners import Boxes
from ...geometry.local_frame import find_bounds
from ...layouts.device_arrays import make_bvh2_nodes
from ...structs import INSTANCE, NODE
from .surface_arrays import INSTANCES, SurfaceArrays


@dataclass(frozen=True, eq=False)
class TopTree:
    """The tree over the instances whose mask is not 0, as the device takes it; see `list_shown`.

    Attributes
    ----------
    nodes : (m,) `BVH2_NODE`
    instances : (n,) `structs.INSTANCE`
        In the order of the leaves.
    bvh : Bvh
        Its primitives are the instances.
    """

    nodes: NDArray[np.void]
    instances: NDArray[np.void]
    bvh: Bvh

    @classmethod
    def build(cls, arrays: SurfaceArrays, ranges: NDArray[np.int32], masks: NDArray[np.uint32]) -> TopTree:
        """Build the tree over the instances of a scene; see `make_records`.

        Raises
        ------
        SceneError
            An instance is too small beside the scene.
        """
        # Imported here: a lone shape needs no builder.
        from ...builders.build import build_top

        shown = list_shown(masks)
        own = take_instances(arrays, shown)
        bvh = build_top(Boxes.from_arrays(*find_boxes(own), "the instances"))
        return cls(make_bvh2_nodes(bvh), make_records(own, ranges, masks[shown], shown, bvh), bvh)


# An instance's box grows by this share of all boxes, besides one of its own size: more than float32 rounds off the ray
# with which the boxes are tested.
_SCENE_GROWTH = 2.0**-19

# The device scales directions by the inverse of an instance's size in the scene; float32 has room for 2^60.
_MOST_INVERSE = 2.0**60

_LOOPS = Loops("world/trees")


def list_shown(masks: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Return the ids of the instances whose mask is not 0; without any that of the first, as a tree needs a leaf."""
    return np.flatnonzero(masks if masks.any() else masks[:1] == 0)


def take_instances(arrays: SurfaceArrays, ids: NDArray[np.int64]) -> SurfaceArrays:
    """Return arrays of some instances, for their boxes and records."""
    names = ("geometry_id", "linear", "offset", "inverse")
    return arrays._replace(**{name: getattr(arrays, name).take(ids, axis=0) for name in names})


def find_boxes(arrays: SurfaceArrays) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of the instances' boxes in the scene's coordinates, each (n, 3) float64.

    A ray that hits an instance meets its box, as far as float32 can tell.
    """
    lower, upper = np.empty(arrays.offset.shape), np.empty(arrays.offset.shape)
    INSTANCES.find_boxes(
        arrays.geometry_id, arrays.linear, arrays.offset, arrays.inverse, arrays.origin, arrays.half_size, lower, upper
    )
    growth = _SCENE_GROWTH * float(np.max(find_bounds(upper)[1] / 2 - find_bounds(lower)[0] / 2))
    lower -= growth
    upper += growth
    return lower, upper


def make_records(
    arrays: SurfaceArrays, ranges: NDArray[np.int32], masks: NDArray[np.uint32], ids: NDArray[np.int64], top: Bvh
) -> NDArray[np.void]:
    """Return the instances as the device takes them, in the order of the leaves of the tree over them.

    Parameters
    ----------
    arrays : SurfaceArrays
        Of n instances.
    ranges : (geometries, 4) int32
        First node, first block, number of blocks and kind of primitives of each geometry, see `structs.INSTANCE`.
    masks : (n,) uint32
    ids : (n,) int64
        In the scene.
    top : Bvh

    Returns
    -------
    (n,) `structs.INSTANCE`

    Raises
    ------
    SceneError
        An instance is too small or too flat beside the scene.
    """
    records = np.zeros(len(masks), INSTANCE)
    bad = INSTANCES.write_records(
        top.prim_ids, arrays.geometry_id, arrays.linear, arrays.offset, arrays.inverse, masks, arrays.origin,
        arrays.half_size, arrays.scale, ranges, top.shape.origin, top.shape.scale, _MOST_INVERSE, records,
    )  # fmt: skip
    if bad >= 0:
        raise SceneError(
            f"the instance {ids[bad]} is smaller than {1 / _MOST_INVERSE:.0e} of the scene, at least "
            "in one direction: leave it out, or make it larger"
        )
    records["instance_id"] = ids[records["instance_id"]]
    return records


def prune_top(top: TopTree, instance_ids: NDArray[np.integer]) -> dict[str, NDArray[np.void]]:
    """Return the arrays of the tree over some instances, by the names of the kernels' arguments.

    Parameters
    ----------
    top : TopTree
    instance_ids : (n,) int
        Without any, the tree is over one instance that nothing sees.

    Notes
    -----
    O(instances of the scene), in this thread: 0.1 to 0.6 ms for 10,000. Leaves keep their boxes; those of interior
    nodes shrink.
    """
    is_left = np.isin(top.instances["instance_id"], instance_ids)
    is_empty = not is_left.any()
    if is_empty:
        is_left[0] = True
    instances = top.instances[is_left]
    if is_empty:
        instances["mask"] = 0
    left_before = np.concatenate((np.zeros(1, np.int32), np.cumsum(is_left, dtype=np.int32)))
    pruned = np.empty(2 * len(instances) - 1, NODE)
    scratch = np.empty(top.bvh.node_count, np.bool_), np.empty(len(pruned), np.int32)
    count = _LOOPS.prune(top.bvh.nodes, left_before, *scratch, pruned)
    # Only the links and the boxes are read, not the primitives.
    bvh = Bvh(pruned[:count], top.bvh.prim_ids, top.bvh.shape)
    return {"top_nodes": make_bvh2_nodes(bvh), "instances": instances}
