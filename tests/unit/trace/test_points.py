"""The nearest point of a surface, and which side of it a point is on."""

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, Tracer, build
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.trace.rays import pieces

from ...rays import centred, edge_midpoints
from ...soup import make_soup
from .nearest_point import CHOICE, check_tree_and_brute_agree, expected_distance

SHAPES = {"icosphere": 320, "knot": 1200, "terrain": 800, "blobs": 640, "boxes": 600}


# Of half the box's size; see docs/tracing.md.
SLACK_OF_FAR_POINTS = 2.0**-9


def points_around(mesh, count, seed):
    generator = np.random.default_rng(seed)
    size = np.ptp(mesh.vertices, axis=0).max()
    anywhere = mesh.origin + generator.uniform(-1, 1, (count, 3)) * size
    close = mesh.vertices[generator.integers(0, len(mesh.vertices), count)] + generator.normal(
        size=(count, 3), scale=size / 200
    )
    midpoints = edge_midpoints(mesh)
    on = np.concatenate((mesh.vertices, midpoints))[generator.integers(0, len(midpoints), count)]
    return np.concatenate((anywhere, close, on))


@pytest.mark.parametrize("shape", SHAPES)
def test_distances_are_right(session, shape):
    mesh = make_shape(shape, triangles=SHAPES[shape])
    points = points_around(mesh, 700, 90)
    with Tracer(build(mesh), device=session.info) as tracer:
        distance, nearest, prim_id = tracer.closest_point(points)
    expected = expected_distance(mesh, points)
    reach = np.abs(points - mesh.origin).max() + np.abs(mesh.vertices - mesh.origin).max()
    assert (distance >= expected - 1e-12 * reach).all()
    assert (distance <= expected + CHOICE * reach).all()
    np.testing.assert_allclose(np.linalg.norm(nearest - points, axis=1), distance, rtol=0, atol=1e-13 * reach)
    # The point is on the face.
    corners = mesh.vertices[mesh.faces[prim_id]]
    again = trimesh.triangles.closest_point(corners, nearest)
    np.testing.assert_allclose(again, nearest, rtol=0, atol=1e-10 * reach)
    assert (distance.dtype, nearest.dtype, prim_id.dtype) == (np.float64, np.float64, np.int32)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_tree_changes_nothing(session, shape):
    mesh = centred(make_shape(shape, triangles=SHAPES[shape]))
    points = points_around(mesh, 3000, 91)
    check_tree_and_brute_agree(session, mesh, points)


def test_ties_go_to_the_smallest_face(session):
    # Over every vertex and every edge of a flat grid, whose faces come in a random order with random first corners.
    generator = np.random.default_rng(92)
    side = np.arange(9)
    vertices = np.stack(np.meshgrid(side, side, [0], indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float64)
    first = (side[:-1, None] * 9 + side[:-1]).reshape(-1)
    faces = np.concatenate(
        (np.stack((first, first + 9, first + 1), 1), np.stack((first + 1, first + 9, first + 10), 1))
    )
    faces = generator.permutation(faces)
    faces = np.stack(
        [np.roll(face, turn) for face, turn in zip(faces, generator.integers(0, 3, len(faces)), strict=True)]
    )
    mesh = Mesh.from_arrays(vertices, faces)
    above_vertices = vertices + np.array([0, 0, 1.7])
    halves = (vertices[faces] + vertices[np.roll(faces, 1, axis=1)]).reshape(-1, 3) / 2 - np.array([0, 0, 0.3])
    with Tracer(build(mesh), device=session.info) as tracer:
        at_vertices = tracer.closest_point(above_vertices).prim_id
        at_edges = tracer.closest_point(halves).prim_id
    touching = [np.flatnonzero((faces == vertex).any(axis=1)).min() for vertex in range(len(vertices))]
    np.testing.assert_array_equal(at_vertices, touching)
    edges = np.sort(np.stack((faces, np.roll(faces, 1, axis=1)), axis=-1).reshape(-1, 2), axis=1)
    smallest = [np.flatnonzero((edges == edge).all(axis=1)).min() // 3 for edge in edges]
    np.testing.assert_array_equal(at_edges, smallest)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e8])
@pytest.mark.parametrize("offset", [0.0, 4.65e6])
def test_scales_and_survey_coordinates(session, scale, offset):
    shape = centred(make_shape("knot", triangles=1200))
    centre = np.full(3, offset * scale)
    mesh = Mesh.from_arrays(shape.vertices * scale + centre, shape.faces)
    points = points_around(shape, 400, 93) * scale + centre
    with Tracer(build(mesh), device=session.info) as tracer:
        distance = tracer.closest_point(points).distance
    # The oracle works at scale 1: it has tolerances.
    expected = scale * expected_distance(shape, (points - centre) / scale)
    np.testing.assert_allclose(distance, expected, rtol=0, atol=CHOICE * 16 * scale)


@pytest.mark.parametrize("far", [1e3, 1e5, 1e7, 1e15, 1e39, 1e300])
def test_points_from_far_away(session, far):
    mesh = make_shape("icosphere", triangles=320)
    directions = np.random.default_rng(94).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    with Tracer(build(mesh), device=session.info) as tracer:
        found = tracer.closest_point(far * directions)
    # What is nearest to a far point is what reaches furthest towards it, as far as docs/tracing.md promises.
    furthest = (mesh.vertices @ directions.T).max(axis=0)
    slack = SLACK_OF_FAR_POINTS * float(np.abs(mesh.vertices).max())
    assert ((found.point * directions).sum(axis=1) >= furthest - slack).all()
    np.testing.assert_allclose(found.distance, far - furthest, rtol=0, atol=slack + far * 1e-15)


class TestInside:
    def test_a_sphere(self, session):
        mesh = make_shape("icosphere", triangles=1280)
        points = np.random.default_rng(95).uniform(-1.3, 1.3, (20_000, 3)) * np.abs(mesh.vertices).max() + mesh.origin
        radius = np.linalg.norm(points - mesh.origin, axis=1) / np.abs(mesh.vertices).max()
        with Tracer(build(mesh), device=session.info) as tracer:
            inside = tracer.contains(points)
            signed = tracer.signed_distance(points)
            distance = tracer.closest_point(points).distance
        sure = (radius < 0.98) | (radius > 1)
        np.testing.assert_array_equal(inside[sure], radius[sure] < 1)
        np.testing.assert_array_equal(signed, np.where(inside, distance, -distance))
        assert 0.1 < inside.mean() < 0.9

    def test_sign_and_value_on_a_cube_at_faces_edges_and_corners(self, session):
        box = trimesh.creation.box()
        points = np.stack(np.meshgrid(*[[-0.75, -0.25, 0.25, 0.5625]] * 3), axis=-1).reshape(-1, 3)
        beyond = np.maximum(np.abs(points) - 0.5, 0)
        within = (0.5 - np.abs(points)).min(axis=1)
        expected = np.where((beyond > 0).any(axis=1), -np.linalg.norm(beyond, axis=1), within)
        for faces in (box.faces, box.faces[:, ::-1]):
            with Tracer(build(Mesh.from_arrays(box.vertices, faces)), device=session.info) as tracer:
                np.testing.assert_allclose(tracer.signed_distance(points), expected, atol=1e-14)

    def test_inside_of_a_hollow_is_outside(self, session):
        outer, inner = trimesh.creation.box(), trimesh.creation.box(extents=[0.2] * 3)
        mesh = trimesh.util.concatenate([outer, inner])
        with Tracer(build(Mesh.from_arrays(mesh.vertices, mesh.faces)), device=session.info) as tracer:
            assert tracer.contains([[0, 0, 0], [0.3, 0.2, 0.1], [2, 0, 0]]).tolist() == [False, True, False]

    @pytest.mark.parametrize("shape", ["icosphere", "knot"])
    def test_what_is_just_below_a_face_is_inside(self, session, shape):
        mesh = make_shape(shape, triangles=SHAPES[shape])
        corners = mesh.vertices[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        step = 1e-5 * np.ptp(mesh.vertices, axis=0).max() * normals / np.linalg.norm(normals, axis=1)[:, None]
        with Tracer(build(mesh), device=session.info) as tracer:
            assert tracer.contains(corners.mean(axis=1) - step).all()
            assert not tracer.contains(corners.mean(axis=1) + step).any()


@pytest.fixture(scope="module")
def tracer(_opened_device):
    with Tracer(build(make_shape("knot", triangles=1800)), device=_opened_device.info) as opened:
        yield opened


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(96).uniform(-4, 4, (3000, 3))


class TestBatches:
    @pytest.mark.parametrize("count", [0, 1, 63, 64, 65, 1023, 1024, 1025])
    def test_any_number_of_points(self, tracer, points, count):
        whole = tracer.closest_point(points)
        for part, expected in zip(tracer.closest_point(points[:count]), whole, strict=True):
            assert part.tobytes() == expected[:count].tobytes()
        np.testing.assert_array_equal(tracer.contains(points[:count]), tracer.contains(points)[:count])
        assert tracer.signed_distance(points[:count]).shape == (count,)

    def test_chunks_strides_and_progress(self, tracer, points, monkeypatch):
        whole = [*tracer.closest_point(points), tracer.contains(points)]
        monkeypatch.setattr(pieces, "CHUNK_RAYS", 1000)
        wide = np.asfortranarray(np.concatenate((points, points), axis=1))
        for batch in (points, wide[:, 3:], points.tolist()):
            told = []
            progress = lambda done, total, told=told: told.append((done, total))  # noqa: E731
            parts = [*tracer.closest_point(batch, progress=progress), tracer.contains(batch, progress=progress)]
            for part, expected in zip(parts, whole, strict=True):
                assert part.tobytes() == expected.tobytes()
            assert told == [(1000, 3000), (2000, 3000), (3000, 3000)] * 2

    def test_float32_is_taken_as_it_is(self, tracer, points):
        single = points.astype(np.float32)
        for obtained, expected in zip(
            tracer.closest_point(single), tracer.closest_point(single.astype(np.float64)), strict=True
        ):
            assert obtained.tobytes() == expected.tobytes()

    @pytest.mark.parametrize("query", ["closest_point", "contains", "signed_distance"])
    def test_bad_points_are_named(self, tracer, query):
        points = np.zeros((9, 3))
        points[[7, 4], 1] = np.nan
        with pytest.raises(ValueError, match=r"^points\[4\] is not finite: "):
            getattr(tracer, query)(points)
        with pytest.raises(
            ValueError, match=r"^points must have shape \(3,\), \(n, 3\) or \(\.\.\., 3\), not \(4, 2\)$"
        ):
            getattr(tracer, query)(np.zeros((4, 2)))

    def test_a_closed_tracer_says_so(self, session):
        opened = Tracer(build(make_shape("icosphere", triangles=80)), device=session.info)
        opened.close()
        for query in ("closest_point", "contains", "signed_distance"):
            with pytest.raises(ValueError, match="the tracer is closed"):
                getattr(opened, query)([[0, 0, 0]])


def test_soups_large_and_small(session):
    mesh = centred(make_soup(400, np.random.default_rng(97)))
    check_tree_and_brute_agree(session, mesh, points_around(mesh, 2000, 98))
