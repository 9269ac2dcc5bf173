"""A scene that moves between a few states, and the answers to queries in each of them."""

from __future__ import annotations

import numpy as np

import clbvh

from ..deform import deform

KINDS = ("closest_hit", "closest_prim", "any_hit", "count_hits", "all_hits")
STATES = 4


class MovingScene:
    """Two meshes, placed eight times, with transforms and vertices of a few states.

    Parameters
    ----------
    triangles : int
        Of each mesh.
    """

    def __init__(self, triangles=3000):
        self.scene = clbvh.Scene()
        self.knot = self.scene.add(clbvh.make_shape("knot", triangles=triangles))
        ball = self.scene.add(clbvh.make_shape("icosphere", triangles=320))
        generator = np.random.default_rng(5)
        places = np.tile(np.eye(4), (STATES, 8, 1, 1))
        places[..., :3, 3] = generator.uniform(-3, 3, (STATES, 8, 3))
        places[..., :3, :3] += generator.uniform(-0.3, 0.3, (STATES, 8, 3, 3))
        self.scene.place_many(self.knot, places[0, :5])
        self.scene.place_many(ball, places[0, 5:])
        self.places = places
        self.vertices = [deform(self.knot.shape, state) for state in range(STATES)]

    def move(self, tracer, state):
        """Set all transforms."""
        tracer.set_transforms(self.scene.instances, self.places[state])

    def deform(self, tracer, state):
        """Set all vertices of the knot."""
        tracer.set_vertices(self.knot, self.vertices[state])

    def make_queries(self, sizes=(40, 500), seed=1):
        """Return (kind, arguments) of each kind and size."""
        generator = np.random.default_rng(seed)
        return [
            (kind, (generator.uniform(-4, 4, (size, 3)), generator.normal(size=(size, 3))))
            for kind in KINDS
            for size in sizes
        ]
