"""What kernels do only on GPUs (IS_GPU) changes no bit of any answer."""

import numpy as np
import pytest

import clbvh
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.trace.world.world import World

from ..rays import centred, hard_rays

RAYS = 5000
POINTS = 200


def make_subject(kind):
    """A mesh, and what is traced: itself, or two turned copies of it in a scene."""
    mesh = centred(make_shape("knot", triangles=1200))
    if kind == "mesh":
        return mesh, mesh
    scene = clbvh.Scene()
    geometry = scene.add(mesh)
    turned = np.eye(4)
    turned[:3, :3] = [[0, -0.5, 0], [0.5, 0, 0], [0, 0, 0.5]]
    turned[:3, 3] = [0.3, 0.1, 0.2]
    for transform in (np.eye(4), turned):
        scene.place(geometry, transform)
    return mesh, scene


def answer_rays(tracer, rays):
    """The bytes of all answers to rays."""
    hits = tracer.closest_hit(*rays)
    assert 0.1 < np.mean(hits.prim_id >= 0) < 1
    return hits.t.tobytes(), hits.prim_id.tobytes(), tracer.any_hit(*rays).tobytes()


def answer_points(tracer, mesh):
    """The bytes of the openness of points on a mesh."""
    corners = mesh.vertices[mesh.faces[:POINTS]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return tracer.ambient_occlusion(corners.mean(axis=1), normals, rays=70, offset=1e-4).tobytes()


@pytest.fixture
def as_on_gpus(monkeypatch):
    """A function; after its call, kernels are compiled as for a GPU."""

    def turn_on():
        defines = World.defines.func
        monkeypatch.setattr(World, "defines", property(lambda world: defines(world) | {"IS_GPU": 1}))

    return turn_on


# Each of the places that ask for IS_GPU, once: kernels are slow to compile.
@pytest.mark.parametrize(("kind", "layout"), [("mesh", "bvh4"), ("scene", "bvh8")])
def test_rays_get_the_same_answers(session, as_on_gpus, kind, layout):
    mesh, subject = make_subject(kind)
    rays = hard_rays(mesh, RAYS, np.random.default_rng(30))
    with clbvh.Tracer(subject, layout=layout) as tracer:
        expected = answer_rays(tracer, rays)
    as_on_gpus()
    with clbvh.Tracer(subject, layout=layout) as tracer:
        assert answer_rays(tracer, rays) == expected


def test_points_get_the_same_answers(session, as_on_gpus):
    mesh, subject = make_subject("mesh")
    with clbvh.Tracer(subject, layout="bvh2") as tracer:
        expected = answer_points(tracer, mesh)
    as_on_gpus()
    with clbvh.Tracer(subject, layout="bvh2") as tracer:
        assert answer_points(tracer, mesh) == expected
