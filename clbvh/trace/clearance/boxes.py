"""Boxes that lie along the surface: one around each node of a tree, and how far apart two of them are.

The boxes of rays are upright. Those of a surface that lies across are as thick as it is wide, and two surfaces that
face each other have thousands of pairs of nodes that could be nearest. See Gottschalk, Lin and Manocha, "OBBTree: a
hierarchical structure for rapid interference detection", 1996.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...support.compiled import compiled
from ...support.loop_functions import cross, dot, subtract
from ..world.surface_arrays import multiply

# Lanes of a box: its centre, half its sides, and its axes, one after the other.
_HALF, _AXES = 3, 6

# Local coordinates are up to 1 and boxes are rounded to float32, their axes too. Corners are placed by sums of three
# products and an offset in float64, and so are boxes.
_BOX_ROOM = 2.0**-20
_PLACE_ROOM = 2.0**-48
_SHRINK = 1.0 - 2.0**-18

# Transforms are similarities if columns are that equal in length and that much at right angles.
_SIMILAR = 2.0**-40


def fit_boxes(tree: Bvh) -> NDArray[np.float32]:
    """Return the boxes of the nodes of a mesh's tree, (N, 15).

    Notes
    -----
    O(triangles times depth), in this thread: 60 ms for 100,000 triangles.
    """
    vertices, faces = tree.mesh.to_local(tree.mesh.vertices), tree.mesh.faces
    first, count = (np.ascontiguousarray(tree.nodes[name]) for name in ("first", "count"))
    parents, normals = np.zeros(tree.node_count, np.int32), np.zeros((tree.node_count, 3))
    _sum_up(first, count, tree.prim_ids, vertices, faces, parents, normals)
    normals[~normals.any(axis=1), 0] = 1.0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # Across the normal, any direction will do: here one far from parallel to it.
    across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    axes = np.stack((normals, across, np.cross(normals, across)), axis=1).astype(np.float32)
    lower, upper = np.full(normals.shape, np.inf), np.full(normals.shape, -np.inf)
    _measure(first, count, tree.prim_ids, vertices, faces, parents, axes, lower, upper)
    centres = np.einsum("nk,nka->na", (lower + upper) / 2.0, axes)
    return np.concatenate((centres, (upper - lower) / 2.0, axes.reshape(-1, 9)), axis=1, dtype=np.float32)


@compiled
def _sum_up(first, count, prim_ids, vertices, faces, parents, normals):
    """Write the parent of each node, and the sum of its triangles' normals, which are as long as these are wide."""
    for node in range(len(first) - 1, -1, -1):
        for slot in range(first[node], first[node] + count[node]):
            a, b, c = _load_corners(vertices, faces, prim_ids[slot])
            normal = cross(subtract(b, a), subtract(c, a))
            for axis in range(3):
                normals[node, axis] += normal[axis]
        if count[node] == 0:
            parents[first[node]] = parents[first[node] + 1] = node
            for axis in range(3):
                normals[node, axis] = normals[first[node], axis] + normals[first[node] + 1, axis]


@compiled
def _measure(first, count, prim_ids, vertices, faces, parents, axes, lower, upper):
    """Write where the triangles of each node begin and end along its axes."""
    for leaf in range(len(first)):
        for slot in range(first[leaf], first[leaf] + count[leaf]):
            for corner in _load_corners(vertices, faces, prim_ids[slot]):
                node = leaf
                while True:
                    for row in range(3):
                        along = dot(corner, (axes[node, row, 0], axes[node, row, 1], axes[node, row, 2]))
                        lower[node, row] = min(lower[node, row], along)
                        upper[node, row] = max(upper[node, row], along)
                    if node == 0:
                        break
                    node = parents[node]


@compiled
def _load_corners(vertices, faces, prim):
    a, b, c = faces[prim, 0], faces[prim, 1], faces[prim, 2]
    return (
        (vertices[a, 0], vertices[a, 1], vertices[a, 2]),
        (vertices[b, 0], vertices[b, 1], vertices[b, 2]),
        (vertices[c, 0], vertices[c, 1], vertices[c, 2]),
    )


class Poses(NamedTuple):
    """How two instances map their local coordinates to the world, in the unit of a search.

    Attributes
    ----------
    maps : (2, 3, 3) float64
    stretch : (2,) float64
        The length of local axes in the world; not above zero where it is not the same for all, or where they are not at
        right angles.
    way : (3,) float64
        From the centre of the first instance to that of the other one.
    room : (1,) float64
        By which boxes and corners may be off.
    """

    maps: NDArray[np.float64]
    stretch: NDArray[np.float64]
    way: NDArray[np.float64]
    room: NDArray[np.float64]


@compiled(error_model="numpy")
def take_poses(arrays, instances, unit, poses):
    """Write the poses of two instances."""
    room = 0.0
    for axis in range(3):
        poses.way[axis] = 0.0
    for which in range(2):
        instance = instances[which]
        geometry = arrays.geometry_id[instance]
        linear, origin, factor = arrays.linear[instance], arrays.origin[geometry], unit / arrays.scale[geometry]
        reach = largest = 0.0
        for row in range(3):
            centre = arrays.offset[instance, row]
            size = abs(centre)
            for column in range(3):
                centre += linear[row, column] * origin[column]
                size += abs(linear[row, column] * origin[column])
                poses.maps[which, row, column] = linear[row, column] * factor
                largest = max(largest, abs(poses.maps[which, row, column]))
            poses.way[row] += centre * unit if which == 1 else -centre * unit
            reach = max(reach, size * unit)
        room += _BOX_ROOM * largest + _PLACE_ROOM * reach

        x, y, z = _column(poses.maps, which, 0), _column(poses.maps, which, 1), _column(poses.maps, which, 2)
        squared = dot(x, x)
        off = max(abs(dot(x, y)), abs(dot(y, z)), abs(dot(z, x)), abs(dot(y, y) - squared), abs(dot(z, z) - squared))
        poses.stretch[which] = np.sqrt(squared) * (1.0 if off <= _SIMILAR * squared else -1.0)
    poses.room[0] = room


@compiled
def _column(maps, which, column):
    return maps[which, 0, column], maps[which, 1, column], maps[which, 2, column]


@compiled
def size_of(boxes, node):
    """Return half the sum of a box's sides."""
    return boxes[node, _HALF] + boxes[node, _HALF + 1] + boxes[node, _HALF + 2]


@compiled(error_model="numpy")
def bound_distance(boxes, a, b, poses):
    """Return at most the squared distance of what is in two boxes, and the squared distance of their centres.

    They are apart by at least the gaps along three axes at right angles: those of either box, or of the world where a
    transform has bent the box.
    """
    of_a, of_b = _place_axes(boxes, a, poses.maps, 0), _place_axes(boxes, b, poses.maps, 1)
    half_a, half_b = _load(boxes, a, _HALF), _load(boxes, b, _HALF)
    way = subtract(multiply(poses.maps, 1, _load(boxes, b, 0)), multiply(poses.maps, 0, _load(boxes, a, 0)))
    way = way[0] + poses.way[0], way[1] + poses.way[1], way[2] + poses.way[2]
    squared = max(
        _bound_along(0, of_a, half_a, of_b, half_b, way, poses), _bound_along(1, of_b, half_b, of_a, half_a, way, poses)
    )
    return squared * _SHRINK, dot(way, way)


@compiled(error_model="numpy")
def _bound_along(which, own, half, other, other_half, way, poses):
    """Return the sum of the squared gaps along the axes of one of two boxes."""
    stretch, squared = poses.stretch[which], 0.0
    for row in range(3):
        if stretch > 0.0:
            axis = own[row]
            gap = (abs(dot(axis, way)) - _reach(axis, other, other_half)) / stretch - half[row] * stretch
        else:
            axis = 1.0 if row == 0 else 0.0, 1.0 if row == 1 else 0.0, 1.0 if row == 2 else 0.0
            gap = abs(way[row]) - _reach(axis, other, other_half) - _reach(axis, own, half)
        gap = max(gap - poses.room[0], 0.0)
        squared += gap * gap
    return squared


@compiled
def _reach(axis, axes, half):
    """Return how far a box reaches along an axis from its centre."""
    return abs(dot(axis, axes[0])) * half[0] + abs(dot(axis, axes[1])) * half[1] + abs(dot(axis, axes[2])) * half[2]


@compiled
def _load(boxes, node, lane):
    return np.float64(boxes[node, lane]), np.float64(boxes[node, lane + 1]), np.float64(boxes[node, lane + 2])


@compiled
def _place_axes(boxes, node, maps, which):
    return (
        multiply(maps, which, _load(boxes, node, _AXES)), multiply(maps, which, _load(boxes, node, _AXES + 3)),
        multiply(maps, which, _load(boxes, node, _AXES + 6)),
    )  # fmt: skip
