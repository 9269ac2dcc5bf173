"""Meshes and rays for which the distances of triangles and of boxes round most differently.

Triangles overlap in one plane and are seen at grazing angles, repeat each other, are a trillion times as long as wide,
or lie in a mesh a million times as long as thick; rays also start on the surface, run along edges, and lie in the sides
of boxes. Distances of different triangles are equal or nearly so, so a box that is culled too early changes the answer.
"""

import numpy as np

from clbvh import Mesh

from .rays import aim, as_float32, axis_rays, centred

# Coordinates on a small grid, so that triangles share corners, edges and planes.
_GRID = 3

# Length over width of slivers, and length over thickness of thin meshes.
_SLIVER_ASPECT = 1e12
_THIN_ASPECT = 1e6


def _as_mesh(corners):
    """A mesh of size 1, as the device has it; scaling by a power of two rounds nothing."""
    corners = corners.reshape(-1, 3)
    exponent = np.frexp(np.ptp(corners, axis=0).max() / 2)[1]
    return centred(Mesh.from_arrays(as_float32(np.ldexp(corners, -exponent)), np.arange(len(corners)).reshape(-1, 3)))


def _turned(corners, generator):
    """In the plane of two axes, in a slanted plane of the grid, or turned by any angle."""
    kind = generator.integers(0, 3)
    if kind == 0:
        return np.roll(corners, generator.integers(0, 3), axis=2)
    if kind == 1:
        slope = generator.integers(-2, 3, 2)
        lifted = corners.copy()
        lifted[..., 2] += corners[..., :2] @ slope
        return np.roll(lifted, generator.integers(0, 3), axis=2)
    turn, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    return corners @ turn


def _overlaps(generator):
    """Triangles of one plane, or of a few parallel ones; some are repeated."""
    count = generator.integers(4, 40)
    corners = generator.integers(-_GRID, _GRID + 1, (count, 3, 3)).astype(np.float64)
    corners[..., 2] = generator.integers(0, generator.integers(1, 3), (count, 1))
    copied = generator.random(count) < 0.3
    corners[copied] = corners[generator.integers(0, count, copied.sum())]
    return _turned(corners, generator)


def _slivers(generator):
    count = generator.integers(4, 40)
    begin, end = generator.uniform(-1, 1, (2, count, 3))
    third = begin + generator.uniform(-0.5, 1.5, (count, 1)) * (end - begin)
    width = generator.choice([1 / _SLIVER_ASPECT, 1e-8, 1e-3], (count, 1))
    return np.stack((begin, end, third + width * generator.normal(size=(count, 3))), axis=1)


def _thin(generator):
    """A grid of points, squeezed along one or two axes."""
    count = generator.integers(4, 60)
    corners = generator.integers(-8, 9, (count, 3, 3)).astype(np.float64)
    squeeze = np.ones(3)
    squeeze[: generator.integers(1, 3)] = 1 / generator.choice([_THIN_ASPECT, 1e4])
    return corners * generator.permutation(squeeze)


def _pair(generator):
    """A plane of overlaps beside one with a small slope."""
    corners = _overlaps(generator)
    tilted = corners[: len(corners) // 2].copy()
    tilted[..., generator.integers(0, 3)] *= 1 + generator.choice([1e-7, 1e-6, 1e-3])
    return np.concatenate((corners, tilted))


MESHES = {"overlaps": _overlaps, "slivers": _slivers, "thin": _thin, "nearly coplanar": _pair}


def make_mesh(kind, generator):
    """A mesh of one of the `MESHES`, at most 60 triangles, somewhere near its origin."""
    corners = MESHES[kind](generator)
    if generator.random() < 0.5:
        corners = corners + generator.uniform(-2, 2, 3)
    return _as_mesh(corners)


def _points(mesh, count, generator):
    """Points of the triangles: inside, on edges and at corners."""
    corners = mesh.vertices[mesh.faces[generator.integers(0, mesh.face_count, count)]].astype(np.float64)
    weights = generator.dirichlet([1, 1, 1], count)
    on_edge = generator.random(count) < 0.2
    weights[on_edge, 2] = 0
    weights[on_edge, :2] /= weights[on_edge, :2].sum(axis=1, keepdims=True)
    at_corner = generator.random(count) < 0.1
    weights[at_corner] = [0, 0, 1]
    return np.einsum("ni,nij->nj", weights, corners), corners


def _grazing(mesh, count, generator):
    """From slightly above the plane of a triangle to a point of it, 1e-7 to 1 times its own size away."""
    target, corners = _points(mesh, count, generator)
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    i, j = generator.uniform(-2, 2, (2, count, 1)) * 10.0 ** generator.uniform(-6, 0, (count, 1))
    height = 10.0 ** generator.uniform(-7, 0, (count, 1)) * generator.choice([-1, 1], (count, 1))
    normal = np.cross(ab, ac)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return aim(target + i * ab + j * ac + height * normal, target)


def _from_surface(mesh, count, generator):
    """From a point of the surface, in any direction or to another point of it."""
    start, corners = _points(mesh, count, generator)
    directions = _points(mesh, count, generator)[0] - start
    anywhere = generator.random(count) < 0.3
    directions[anywhere] = generator.normal(size=(anywhere.sum(), 3))
    # Along the triangle, and nearly so.
    inside = generator.random(count) < 0.5
    i, j = generator.uniform(-1, 1, (2, inside.sum(), 1))
    a, b, c = corners[inside].transpose(1, 0, 2)
    directions[inside] = i * (b - a) + j * (c - a)
    directions += 10.0 ** generator.uniform(-14, -3, (count, 1)) * generator.normal(size=(count, 3))
    # Exactly on it, or beside it by less than float32 resolves at distance 1.
    beside = 10.0 ** generator.uniform(-16, -7, (count, 1)) * (generator.random((count, 1)) < 0.5)
    return as_float32(start + beside * generator.normal(size=(count, 3))), as_float32(directions)


def _along_edges(mesh, count, generator):
    """Along the edge of a triangle, from before its beginning or from one of its points."""
    prims, first = generator.integers(0, mesh.face_count, count), generator.integers(0, 3, count)
    a = mesh.vertices[mesh.faces[prims, first]].astype(np.float64)
    b = mesh.vertices[mesh.faces[prims, (first + 1) % 3]].astype(np.float64)
    return as_float32(a - generator.choice([0, 1, 0.25, -0.5], (count, 1)) * (b - a)), as_float32(b - a)


RAYS = {"grazing": _grazing, "from surface": _from_surface, "along edges": _along_edges, "axis": axis_rays}


def make_rays(kind, mesh, count, generator):
    """Rays of one of the `RAYS`, with directions of moderate length, as the host casts them."""
    origins, directions = RAYS[kind](mesh, count, generator)
    longest = np.abs(directions).max(axis=1)
    directions[longest == 0] = [0, 0, 1]
    longest[longest == 0] = 1
    directions = np.ldexp(directions, -np.frexp(longest)[1][:, None])
    return as_float32(origins), as_float32(directions)
