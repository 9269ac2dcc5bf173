"""Shapes that are hard for a builder: tiny, huge, flat, without extent, nested, all alike."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from clbvh import Mesh, Spheres

from ...soup import make_soup

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)


def from_corners(corners):
    """Return the mesh of (n, 3, 3) corners."""
    corners = np.asarray(corners, float)
    return Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def copies(count):
    return from_corners(np.tile(TRIANGLE, (count, 1, 1)))


def nested(count):
    """Return triangles of all sizes with one centroid."""
    return from_corners(np.arange(1, count + 1)[:, None, None] * np.array([[-1, -1, -1], [1, 1, 1], [1, -1, 1]]))


def line(count):
    """Return triangles without area along a diagonal."""
    return from_corners(np.random.default_rng(1).integers(0, 1000, (count, 3, 1)) * np.array([1, 2, -3]))


def exponential(copies=1):
    """Return triangles on three axes, each 1.5 times as large and as far away as the one before."""
    distances = 1e-32 * 1.5 ** np.arange(int(math.log(1e66, 1.5)))
    corners = np.zeros((len(distances), 3, 3))
    number = np.arange(len(distances))
    corners[number, :, number % 3] = distances[:, None]
    corners += distances[:, None, None] * 1e-3 * np.eye(3)
    corners = np.repeat(corners, copies, axis=0)
    return from_corners(np.concatenate([corners, -corners]))


def spheres(count):
    random = np.random.default_rng(count)
    return Spheres(random.normal(size=(count, 3)), 10.0 ** random.uniform(-3, -1, count))


MESHES = {
    **{str(count): partial(make_soup, count, seed=1) for count in (1, 2, 3, 9)},
    "soup": lambda: make_soup(700, seed=2, copies=0.3, degenerate=0.1),
    "on a grid": lambda: make_soup(500, seed=3, grid=3, size=1),
    "nested": lambda: nested(400),
    "copies": lambda: copies(2000),
    "copies of two": lambda: from_corners(np.concatenate([np.tile(TRIANGLE, (999, 1, 1)), [TRIANGLE + 5] * 1000])),
    "one point": lambda: from_corners(np.ones((300, 3, 3))),
    "line": lambda: line(300),
    "exponential": exponential,
    "below normal numbers": lambda: make_soup(300, seed=6, scale=1e-43),
    "1e38": lambda: make_soup(300, seed=6, scale=1.6e35),
    "as wide as float32": lambda: make_soup(300, seed=6, grid=1000, size=0, scale=6.7e35),
    "signed zeros": lambda: from_corners(np.random.default_rng(8).choice([-1, -0.0, 0.0, 1], (300, 3, 3))),
}

SHAPES = MESHES | {
    "a sphere": lambda: spheres(1),
    "spheres": lambda: spheres(700),
    "spheres in each other": lambda: Spheres(np.zeros((300, 3)), np.geomspace(1e-30, 1, 300)),
}
