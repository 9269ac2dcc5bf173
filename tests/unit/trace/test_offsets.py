"""Start points of rays that leave a surface: they never meet what they leave."""

import numpy as np
import pytest
import trimesh

from clbvh.builders.build import build
from clbvh.errors import ConfigError, QueryError
from clbvh.geometry import Mesh
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.structs import NO_PRIM
from clbvh.trace.hits.hits import Hits
from clbvh.trace.tracer import Tracer

RAYS = 4000


def make_soup(generator, thickness=1.0):
    """Triangles of all sizes; their third corner is this far from the edge of the first two."""
    a = generator.normal(size=(200, 3))
    ab = generator.normal(size=(200, 3)) * 10.0 ** generator.uniform(-6, 0, (200, 1))
    c = (
        a
        + ab * generator.random((200, 1))
        + generator.normal(size=(200, 3)) * np.abs(ab).max(axis=1)[:, None] * thickness
    )
    return np.stack([a, a + ab, c], axis=1).reshape(-1, 3), np.arange(600).reshape(-1, 3)


MESHES = {
    "soup": lambda generator: make_soup(generator),
    "slivers": lambda generator: make_soup(generator, 10.0 ** generator.uniform(-8, -3, (200, 1))),
    "needles": lambda generator: make_soup(generator, 10.0 ** generator.uniform(-20, -8, (200, 1))),
    "knot": lambda generator: (lambda mesh: (mesh.vertices @ turn(generator), mesh.faces))(
        make_shape("knot", triangles=2000)
    ),
}


def turn(generator):
    return np.linalg.qr(generator.normal(size=(3, 3)))[0]


def make_hits(tracer, mesh, generator, count=RAYS):
    """Hits of rays at points of the triangles, many of them close to edges, from near and far."""
    faces = generator.integers(mesh.face_count, size=count)
    weights = generator.dirichlet(np.full(3, 0.4), count)
    targets = (weights[:, :, None] * mesh.vertices[mesh.faces[faces]]).sum(axis=1)
    away = generator.normal(size=(count, 3)) * np.ptp(mesh.vertices) * 10.0 ** generator.uniform(-2, 1, (count, 1))
    hits = tracer.closest_hit(targets + away, -away)
    return hits[hits.is_hit]


def make_directions(normals, generator):
    """Directions of any length over the half space of each normal, many of them along its plane."""
    directions = generator.normal(size=normals.shape)
    heights = (directions * normals).sum(axis=1, keepdims=True)
    flatness = generator.choice([1.0, 1e-3, 1e-6, 1e-9, 0.0], (len(normals), 1))
    directions += (flatness * np.abs(heights) - heights) * normals
    return directions * 10.0 ** generator.uniform(-20, 20, (len(normals), 1))


def find_own(tracer, hits, origins, directions):
    """Whether any query reports the triangle that each ray leaves."""
    crossings = tracer.all_hits(origins, directions)
    own = tracer.closest_prim(origins, directions) == hits.prim_id
    own[crossings.ray_id[crossings.prim_id == hits.prim_id[crossings.ray_id]]] = True
    return own


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("far", [0.0, 1e3, 1e9, 1e13])
@pytest.mark.parametrize("name", MESHES)
class TestOwnTriangle:
    def open(self, session, name, far, size):
        generator = np.random.default_rng(13)
        vertices, faces = MESHES[name](generator)
        mesh = Mesh.from_arrays((vertices + far * generator.normal(size=3)) * size, faces)
        return mesh, Tracer(build(mesh), device=session.info), generator

    def test_on_the_side_of_the_viewer(self, session, name, far, size):
        mesh, tracer, generator = self.open(session, name, far, size)
        with tracer:
            hits = make_hits(tracer, mesh, generator)
            towards_viewer = np.where(hits.is_front[:, None], hits.normals, -hits.normals)
            directions = make_directions(towards_viewer, generator)
            assert not find_own(tracer, hits, hits.offset_origins(), directions).any()

    def test_towards_any_direction(self, session, name, far, size):
        mesh, tracer, generator = self.open(session, name, far, size)
        with tracer:
            hits = make_hits(tracer, mesh, generator)
            directions = generator.normal(size=(len(hits), 3))
            directions -= generator.choice([0.0, 0.999999, 1.0], (len(hits), 1)) * (
                (directions * hits.normals).sum(axis=1, keepdims=True) * hits.normals
            )
            assert not find_own(tracer, hits, hits.offset_origins(towards=directions), directions).any()


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("name", ["ball", "box", "floor"])
def test_rays_that_leave_a_convex_mesh_meet_nothing(session, name, size):
    generator = np.random.default_rng(17)
    if name == "ball":
        shape = make_shape("icosphere", triangles=1280)
        vertices, faces = shape.vertices * [1, 0.2, 3] @ turn(generator), shape.faces
    elif name == "box":
        box = trimesh.creation.box((2.0, 0.5, 1.0))
        vertices, faces = box.vertices @ turn(generator), box.faces
    else:
        vertices, faces = make_floor()
        vertices = vertices @ turn(generator)
    mesh = Mesh.from_arrays((vertices + generator.normal(size=3)) * size, faces)
    with Tracer(build(mesh), device=session.info) as tracer:
        hits = make_hits(tracer, mesh, generator, 20_000)
        assert len(hits) > 5000
        if name == "floor":
            outside = np.where(hits.is_front, 1.0, -1.0)[:, None]
        else:
            hits, outside = hits[hits.is_front], 1.0
        directions = make_directions(outside * hits.normals, generator)
        assert not tracer.any_hit(hits.offset_origins(), directions).any()
        # The rays are hard ones: without an offset, many meet the mesh.
        assert tracer.any_hit(hits.locations, directions).mean() > 0.01


def make_floor():
    """A square of many triangles in one plane."""
    side = np.arange(12)
    vertices = np.stack(np.meshgrid(side, side, [0]), axis=-1).reshape(-1, 3) / 11.0
    corners = np.arange(144).reshape(12, 12)
    a, b, c, d = (
        block.reshape(-1) for block in (corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:])
    )
    return vertices, np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


@pytest.fixture(scope="module")
def tracer(_opened_device):
    mesh = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    with Tracer(build(mesh), device=_opened_device.info) as opened:
        yield opened


class TestSides:
    def test_is_front(self, tracer):
        origins = [[0.2, 0.2, 1], [0.2, 0.2, -1], [5, 5, 5]]
        directions = [[0, 0, -1], [0, 0, 1], [0, 0, 1]]
        assert tracer.closest_hit(origins, directions).is_front.tolist() == [True, False, False]
        crossings = tracer.all_hits(origins, directions)
        assert crossings.is_front.tolist() == [True, False]
        assert (crossings.offset_origins()[:, 2] > 0).tolist() == [True, False]

    def test_points_are_close_to_the_surface_and_above_the_hit(self, tracer):
        origins = np.random.default_rng(19).random((100, 3)) * [0.4, 0.4, 1.0]
        hits = tracer.closest_hit(origins, [0, 0, -1])
        points = hits.offset_origins()
        np.testing.assert_array_equal(points[:, :2], hits.locations[:, :2])
        assert (points[:, 2] > 0).all()
        assert (points[:, 2] < 1e-5).all()

    def test_towards_broadcasts(self, tracer):
        hits = tracer.closest_hit([[0.2, 0.2, 1], [0.3, 0.3, -1]], [[0, 0, -1], [0, 0, 1]])
        directions = np.array([[0, 0, 1], [0, 0, -1], [1, 0, -1e-300], [5e-324, 0, 5e-324]])[:, None]
        points = hits.offset_origins(towards=directions)
        assert points.shape == (4, 2, 3)
        assert (points[..., 2] > 0).tolist() == [[True, True], [False, False], [False, False], [True, True]]
        assert hits.offset_origins(towards=[0, 0, 1]).shape == (2, 3)
        assert hits[0].offset_origins().shape == (3,)
        assert hits[0].offset_origins(towards=np.ones((7, 3))).shape == (7, 3)

    def test_a_light_behind_the_triangle_is_blocked_by_it(self, tracer):
        hits = tracer.closest_hit([0.2, 0.2, 1], [0, 0, -1])
        assert tracer.any_hit(hits.offset_origins(), [0, 0, -1])
        assert not tracer.any_hit(hits.offset_origins(towards=[0, 0, -1]), [0, 0, -1])

    def test_misses_are_nan_and_left_out_by_is_hit(self, tracer):
        hits = tracer.closest_hit([[0.2, 0.2, 1], [9, 9, 1]], [0, 0, -1])
        for points in (hits.offset_origins(), hits.offset_origins(towards=[0, 0, 1])):
            assert np.isnan(points).all(axis=1).tolist() == [False, True]
        with pytest.raises(QueryError, match="is not finite"):
            tracer.any_hit(hits.offset_origins(), [0, 0, 1])
        assert tracer.any_hit(hits[hits.is_hit].offset_origins(), [0, 0, 1]).tolist() == [False]
        assert hits[[]].offset_origins().shape == hits[[]].offset_origins(towards=[0, 0, 1]).shape == (0, 3)

    def test_hits_of_unknown_side_ask_for_directions(self):
        mesh = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        hits = Hits(*np.array([[1.0, np.inf], [0.2, 0], [0.2, 0]]), np.array([0, NO_PRIM], np.int32), mesh)
        with pytest.raises(ConfigError, match=r"call offset_origins\(towards=directions\)$"):
            hits.offset_origins()
        assert hits.offset_origins(towards=[0, 0, 1])[0, 2] > 0
        with pytest.raises(ConfigError, match="do not know their mesh"):
            Hits(*np.zeros((3, 2)), np.zeros(2, np.int32)).offset_origins(towards=[0, 0, 1])

    def test_wrong_directions(self, tracer):
        hits = tracer.closest_hit(np.ones((4, 3)), [0, 0, -1])
        with pytest.raises(QueryError, match=r"^towards must have a shape that broadcasts against that of the hits"):
            hits.offset_origins(towards=np.ones((5, 3)))
        with pytest.raises(QueryError, match=r"^towards must have shape \(3,\)"):
            hits.offset_origins(towards=np.ones((4, 2)))


def test_normals_of_triangles_without_area_are_across_them():
    """Collinear corners that float32 sees as a triangle are hit, and then have to be left."""
    direction = np.array([0.3, 0.5, 0.7])
    mesh = Mesh.from_arrays([0 * direction, direction, 0.5 * direction, [1, 1, 1]], [[0, 1, 2], [0, 0, 0]])
    hits = Hits(np.ones(2), np.zeros(2), np.zeros(2), np.array([0, 1], np.int32), mesh)
    assert np.linalg.norm(hits.normals[0]) == pytest.approx(1)
    assert abs(hits.normals[0] @ direction) < 1e-15
    assert np.isnan(hits.normals[1]).all()
