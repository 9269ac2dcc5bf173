"""Start points of rays that leave merged instances: they never meet what they leave."""

import numpy as np
import pytest

import clbvh
from clbvh.trace.scene import merging as merge_rule
from tests.unit.trace.test_offsets import MESHES as OFFSET_MESHES, make_directions, turn
from tests.unit.trace.test_placed_offsets import count_own

RAYS = 6000
PARTS = 12


def make_soup(generator, thickness):
    """Triangles so large that none vanishes in a merged mesh; their third corner is this far from their first edge."""
    a = generator.normal(size=(100, 3))
    ab = generator.normal(size=(100, 3)) * 10.0 ** generator.uniform(-2, 0, (100, 1))
    c = a + ab * generator.random((100, 1)) + generator.normal(size=(100, 3)) * np.abs(ab).max() * thickness
    return np.stack([a, a + ab, c], axis=1).reshape(-1, 3), np.arange(300).reshape(-1, 3)


MESHES = {
    "soup": lambda generator: make_soup(generator, 0.1),
    "slivers": lambda generator: make_soup(generator, 1e-3),
    "knot": OFFSET_MESHES["knot"],
}

# The flattest of the rotated ones is the flattest that is merged, see `merge_rule`.
MAPS = {
    "rotation": lambda generator: turn(generator),
    "flat-2": lambda generator: np.diag([1, 1, 1e-2]),
    "flat-4": lambda generator: np.diag([1, 1e-4, 1]),
    "flat-6": lambda generator: np.diag([1e-6, 1, 1]),
    "turned-2": lambda generator: turn(generator) @ np.diag([1, 1, 1e-2]),
    "turned-4": lambda generator: turn(generator) @ np.diag([1, 1, 1e-4]) @ turn(generator),
    "turned-5": lambda generator: turn(generator) @ np.diag([1, 1e-5, 1]) @ turn(generator),
    "mirror": lambda generator: turn(generator) @ np.diag([1, -1, 1e-3]),
    "shear": lambda generator: turn(generator) @ np.array([[1, 100, 0], [0, 1, 0], [0, 0, 1]]) @ turn(generator) / 100,
}


def make_scene(kind, name, far, size, spread, generator):
    """Parts of one size in a box of this many sizes, as far from zero."""
    scene = clbvh.Scene()
    for _ in range(PARTS):
        transform = np.eye(4)
        linear = MAPS[name](generator)
        transform[:3, :3] = linear * size * np.sign(np.linalg.det(linear)) * (-1 if name == "mirror" else 1)
        transform[:3, 3] = (generator.uniform(-spread, spread, 3) + far) * size
        scene.place(scene.add(clbvh.Mesh.from_arrays(*MESHES[kind](generator))), transform)
    return scene


def make_hits(tracer, scene, size, generator):
    """Hits of rays at points of all parts, many of them close to edges, from near and far."""
    targets = []
    for instance in scene.instances:
        mesh = instance.geometry.shape
        faces = generator.integers(mesh.face_count, size=RAYS // PARTS)
        weights = generator.dirichlet(np.full(3, 0.4), len(faces))
        points = (weights[:, :, None] * mesh.vertices[mesh.faces[faces]]).sum(axis=1)
        targets.append(points @ instance.transform[:3, :3].T + instance.transform[:3, 3])
    targets = np.concatenate(targets)
    away = generator.normal(size=targets.shape) * size * 10.0 ** generator.uniform(-2, 1, (len(targets), 1))
    hits = tracer.closest_hit(targets + away, -away)
    return hits[hits.is_hit]


@pytest.fixture(autouse=True)
def merge_thin_parts(monkeypatch):
    """Of flattened parts most would stay instances."""
    monkeypatch.setattr(merge_rule, "_LEAST_THICKNESS", 1e-30)


def open_merged(scene, session):
    tracer = clbvh.Tracer(scene, device=session.info)
    (merged,) = tracer._caster.tree.merging.meshes
    assert len(merged.merged_ids) == PARTS
    return tracer


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize(("far", "size", "spread"), [(0, 1, 4), (1e7, 1, 4), (0, 1e-30, 60), (1e3, 1e30, 60)])
def test_rays_do_not_meet_the_triangle_that_they_leave(session, kind, name, far, size, spread):
    generator = np.random.default_rng(31)
    scene = make_scene(kind, name, far, size, spread, generator)
    with open_merged(scene, session) as tracer:
        hits = make_hits(tracer, scene, size, generator)
        assert len(hits) > 20
        directions = make_directions(hits.normals(facing=True), generator)
        assert count_own(tracer, hits, hits.offset_origins(), directions).sum() == 0
        # Through the surface, on the side to which a direction leads.
        towards = generator.normal(size=(len(hits), 3)) * size
        assert count_own(tracer, hits, hits.offset_origins(towards=towards), towards).sum() == 0
