"""Closed meshes, points inside of them, and rays from there that a leak would let out."""

import os
from pathlib import Path

import numpy as np

from clbvh import Mesh, Tracer, build, load_mesh, make_shape

from .rays import AXES, aim, as_float32, centred, edge_midpoints


def deep_inside(mesh):
    """A function from a count and a generator to points of a closed mesh with a distance to its surface."""
    low, size = mesh.vertices.min(axis=0), np.ptp(mesh.vertices, axis=0)
    with Tracer(build(mesh)) as tracer:
        points = low + np.random.default_rng(53).uniform(size=(20_000, 3)) * size
        points = as_float32(points[tracer.signed_distance(points) > 0.03 * size.max()])
    assert len(points) > 500
    return lambda count, generator: points[generator.integers(0, len(points), count)]


def scan_path(name):
    """Where a scan is, or where it would be."""
    return Path(os.environ.get("CLBVH_MESHES", "")) / name


BUNNY = "bun_zipper.ply"
NAMES = ("icosphere", "knot", "bunny")


def open_closed_mesh(name, *, larger=1):
    """Return a closed mesh around its own zero, and a function from a count and a generator to points inside."""
    if name == "bunny":
        mesh = close_holes(load_mesh(scan_path(BUNNY)))
    else:
        mesh = make_shape(name, triangles={"knot": 20_000, "icosphere": 5120}[name] * larger, seed=1)
    # Every edge belongs to two triangles, once in each sense.
    edges = np.unique(edges_of(mesh.faces), axis=0)
    assert np.array_equal(edges, np.unique(edges[:, ::-1], axis=0))
    assert len(edges) == 3 * mesh.face_count
    return centred(mesh), deep_inside(centred(mesh))


def rays_at(targets, inside, count, generator):
    return aim(inside(count, generator), targets[generator.integers(0, len(targets), count)])


def at_vertices(mesh, inside, count, generator):
    return rays_at(mesh.vertices, inside, count, generator)


def at_edges(mesh, inside, count, generator):
    return rays_at(edge_midpoints(mesh), inside, count, generator)


def along_axes(mesh, inside, count, generator):
    """From points that share coordinates with vertices where that is inside: in the planes of boxes."""
    origins = inside(count, generator)
    vertices = mesh.vertices[generator.integers(0, len(mesh.vertices), count)]
    axis = generator.integers(0, 3, count)[:, None] == np.arange(3)
    margin = min(0.05, 0.025 * float(np.ptp(mesh.vertices, axis=0).max()))
    near = axis & (np.abs(vertices - origins) < margin)
    return np.where(near, vertices, origins), AXES[generator.integers(0, 6, count)].astype(np.float64)


def nearly_along_axes(mesh, inside, count, generator):
    origins, directions = along_axes(mesh, inside, count, generator)
    tilt = 10 ** generator.uniform(-44, -4, directions.shape) * generator.choice([-1, 1], directions.shape)
    return origins, as_float32(np.where(directions == 0, tilt, directions))


def anywhere(mesh, inside, count, generator):
    return inside(count, generator), as_float32(generator.normal(size=(count, 3)))


def side_by_side(mesh, inside, count, generator):
    """From one point to vertices and edges, ordered by direction: neighbours share an entry point."""
    origin = inside(1, generator)
    targets = np.concatenate((mesh.vertices, edge_midpoints(mesh)))
    directions = as_float32(targets[generator.integers(0, len(targets), count)] - origin)
    height = directions[:, 2] / np.linalg.norm(directions, axis=1)
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    order = np.lexsort((azimuth, np.floor(height * np.sqrt(count) / 4)))
    return np.broadcast_to(origin, directions.shape), directions[order]


MAKERS = [at_vertices, at_edges, along_axes, nearly_along_axes, anywhere, side_by_side]


def edges_of(faces):
    """(3 F, 2): the edges of all triangles, in their sense."""
    return np.concatenate([faces[:, [i, j]] for i, j in ((0, 1), (1, 2), (2, 0))]).astype(np.int64)


def close_holes(mesh):
    """The mesh with a vertex in the middle of its holes' borders, joined to all of them.

    Lids of different holes may cross each other; counts do not mind.
    """
    edges, sides = edges_of(mesh.faces), np.array([len(mesh.vertices), 1])
    border = edges[~np.isin(edges @ sides, edges[:, ::-1] @ sides)]
    lids = np.column_stack((border[:, ::-1], np.full(len(border), len(mesh.vertices))))
    middle = mesh.vertices[border[:, 0]].mean(axis=0, keepdims=True)
    return Mesh.from_arrays(np.concatenate((mesh.vertices, middle)), np.concatenate((mesh.faces, lids)), name="closed")
