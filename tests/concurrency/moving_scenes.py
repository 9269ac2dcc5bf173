"""Meshes, spheres and scenes that move between a few states, and queries that tell these apart."""

import numpy as np

import clbvh

from ..deform import deform
from .queries import make_queries

KINDS = ("closest_hit", "closest_prim", "any_hit", "count_hits", "all_hits")
STATES = 4


class MovingScene:
    """Two meshes, placed eight times, with transforms and vertices of a few states."""

    def __init__(self):
        self.scene = self.source = clbvh.Scene()
        self.knot = self.scene.add(clbvh.make_shape("knot", triangles=3000))
        ball = self.scene.add(clbvh.make_shape("icosphere", triangles=320))
        generator = np.random.default_rng(5)
        self.places = np.tile(np.eye(4), (STATES, 8, 1, 1))
        self.places[..., :3, :] += generator.uniform(-0.3, 0.3, (STATES, 8, 3, 4)) * [1, 1, 1, 10]
        self.scene.place_many(self.knot, self.places[0, :5])
        self.scene.place_many(ball, self.places[0, 5:])
        self.vertices = [deform(self.knot.shape, state) for state in range(STATES)]
        self.changes = self.move, self.deform

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


class MovingMasks:
    """A ball in front of another one, of which queries see both, either or none."""

    def __init__(self):
        ball = clbvh.make_shape("icosphere", triangles=320)
        self.source = clbvh.Scene(ball)
        self.source.place(self.source.geometries[0], clbvh.Transform(translate=(0.5, 0, 3)))
        masks = [3, 3], [0, 3], [1, 0], [0, 0]
        self.changes = (lambda tracer, state: tracer.set_masks([0, 1], masks[state]),)
        self._mesh = ball

    def make_queries(self):
        """Return (kind, arguments), those of points, too."""
        return make_queries(self._mesh, (1, 700), seed=1)


class MovingMesh:
    """A lone mesh."""

    def __init__(self):
        self.source = clbvh.make_shape("knot", triangles=6000)
        self.vertices = [deform(self.source, state) for state in range(STATES)]
        self.changes = (lambda tracer, state: tracer.update(self.vertices[state]),)

    def make_queries(self):
        """Return (kind, arguments), those of points, too."""
        return make_queries(self.source, (1, 700), seed=1)


class MovingSpheres:
    """Spheres, alone in their scene or beside others; they are refitted, and sometimes built anew."""

    def __init__(self, *, is_alone):
        generator = np.random.default_rng(7)
        centres = generator.uniform(-2, 2, (STATES, 500, 3))
        centres[1:-1] = centres[0] + generator.uniform(-0.05, 0.05, (STATES - 2, 500, 3))
        self.source = clbvh.Scene()
        dots = self.source.add(clbvh.Spheres(centres[0], 0.1))
        self.source.place(dots)
        if not is_alone:
            self.source.place(self.source.add(clbvh.Spheres(centres[0], 0.01)))
        self.changes = (lambda tracer, state: tracer.set_spheres(dots, centres[state], 0.1 + 0.01 * state),)
        self.rays = generator.uniform(-3, 3, (2000, 3)), generator.normal(size=(2000, 3))

    def make_queries(self):
        """Return (kind, arguments)."""
        return [("closest_hit", self.rays)]
