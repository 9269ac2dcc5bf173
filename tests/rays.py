"""Rays that are hard for a traversal, for tests of every kind.

All coordinates fit float32, so that the oracle judges the very rays that the device cast.
"""

from itertools import pairwise

import numpy as np

from clbvh import Mesh

# The directions of the six half-axes, with zeros of both signs.
AXES = np.array(
    [[1, 0, 0], [-1, 0, -0.0], [0, 1, 0], [-0.0, -1, 0], [0, 0, 1], [0, -0.0, -1]],
    np.float32,
)


def as_float32(values):
    """Round to float32, at its largest numbers if need be, and keep float64."""
    largest = np.finfo(np.float32).max
    return np.clip(values, -largest, largest).astype(np.float32).astype(np.float64)


def mesh_as_on_device(corners, faces, name="mesh"):
    """A mesh whose coordinates are the device's own: nothing is moved, scaled or rounded on the way there."""
    local = np.ascontiguousarray(corners, np.float32)
    return Mesh(local.astype(np.float64), np.ascontiguousarray(faces, np.int32), local, np.zeros(3), 1.0, name)


def centred(mesh):
    """The same mesh in its own local coordinates."""
    return mesh_as_on_device(mesh.local_vertices, mesh.faces, mesh.name)


def edge_midpoints(mesh):
    """The middle of every edge, (3 F, 3), as near as float32 gets."""
    corners = mesh.vertices[mesh.faces]
    return as_float32((corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2)


def aim(origins, targets):
    """Rays from each origin to its target."""
    origins = as_float32(origins)
    return origins, as_float32(np.broadcast_to(targets, origins.shape) - origins)


def random_rays(mesh, count, generator):
    """From anywhere in twice the mesh's box to anywhere in it."""
    size = np.ptp(mesh.vertices, axis=0).astype(np.float64)
    centre = mesh.vertices.min(axis=0) + size / 2
    origins = centre + generator.uniform(-1, 1, (count, 3)) * size
    return aim(origins, centre + generator.uniform(-0.5, 0.5, (count, 3)) * size)


def axis_rays(mesh, count, generator):
    """Along the axes, the coordinates taken from vertices: they run in the faces of boxes and through vertices."""
    size = float(np.ptp(mesh.vertices, axis=0).max())
    directions = AXES[np.arange(count) % len(AXES)].astype(np.float64)
    origins = mesh.vertices[generator.integers(0, len(mesh.vertices), count)] - 2 * size * directions
    return as_float32(origins), directions


def feature_rays(mesh, count, generator):
    """From around the mesh to its vertices and the middles of its edges."""
    origins, _ = random_rays(mesh, count, generator)
    targets = np.concatenate((mesh.vertices, edge_midpoints(mesh)))
    return aim(origins, targets[generator.integers(0, len(targets), count)])


def hard_rays(mesh, count, generator):
    """A third of each kind."""
    kinds = [make(mesh, count // 3, generator) for make in (random_rays, axis_rays, feature_rays)]
    return tuple(np.concatenate(parts) for parts in zip(*kinds, strict=True))


def order_by_keys(count, make_keys, parts=2):
    """Return the order of items by keys that are made in several parts, as `Call.order_by_keys` does."""
    keys, ends = np.empty(count, np.int32), np.linspace(0, count, parts + 1).astype(int)
    for begin, end in pairwise(ends):
        make_keys(begin, end, keys[begin:end])
    return np.argsort(keys, kind="stable").astype(np.int32)
