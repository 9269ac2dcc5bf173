"""The k nearest primitives of points, the nearest vertex, the face that faces a point, against all in float64."""

import numpy as np
import pytest
import trimesh

from clbvh import ClosestPoints, ConfigError, Mesh, QueryError, Scene, Spheres, Tracer, build, make_shape
from clbvh.integrations.trimesh.nearest import choose_facing, find_nearest_vertices
from clbvh.trace.points import queries, search
from clbvh.tree_layouts import TREE_LAYOUTS

from ...rays import centred
from ...soup import make_soup
from .scene_distances import SceneDistances, points_around
from .scene_states import affine, random_linear

K = 6
TOLERANCE = 1e-8


@pytest.fixture(scope="module")
def scene():
    """Meshes and spheres of all sizes, sheared and mirrored."""
    generator, made = np.random.default_rng(1450), Scene()
    balls = made.add(Spheres(generator.normal(size=(30, 3)), 10.0 ** generator.uniform(-2, -0.5, 30)))
    knot = made.add(make_shape("knot", triangles=170))
    for index, size in enumerate((1, 1e-6, 1, 1e-3)):
        linear = size * random_linear(generator)
        made.place(knot, affine(linear, (3 * index, 0, 0)), mask=1 << index)
        made.place(balls, affine(linear, (3 * index, 5 * (index % 2), 0)), mask=1 << index)
    return made


@pytest.fixture(scope="module")
def known(scene):
    """Points around the scene, near its smallest instances, and far away; and how they lie to it."""
    generator = np.random.default_rng(1451)
    near = [scale * generator.normal(size=(20, 3)) + [3, 0, 0] for scale in (3e-6, 300)]
    points = np.concatenate((points_around(scene.snapshot(), generator, 20), *near))
    return SceneDistances(scene.snapshot(), points)


def as_bytes(closest):
    return [array.tobytes() for array in (*closest, closest.instance_id, closest.geometry_id)]


def test_they_are_right_in_any_layout_and_in_any_rounds(open_tracer, scene, known, monkeypatch):
    answers = [open_tracer(scene, layout=layout).closest_points(known.points, K) for layout in TREE_LAYOUTS]
    known.check_points(answers[0], K)
    monkeypatch.setattr(search, "MOST_SLOTS", 100)
    monkeypatch.setattr(queries, "_SPARE_SLOTS", 1)
    told = []
    tracer = open_tracer(scene)
    answers.append(tracer.closest_points(known.points, K, progress=lambda done, total: told.append((done, total))))
    assert len(told) > 1
    assert told[-1] == (len(known.points),) * 2
    for answer in answers[1:]:
        assert as_bytes(answer) == as_bytes(answers[0])


def test_only_what_is_seen_counts_and_k_may_be_more(open_tracer, scene, known):
    masks = np.random.default_rng(1460).integers(0, 16, len(known.points)).astype(np.uint32)
    for k, options, seen in (
        (1, {}, True),
        (500, {"instance": 0}, np.arange(8) == 0),
        (K, {"mask": masks}, (masks[:, None] & known.state.masks) != 0),
        (K, {"geometry": scene.geometries[1]}, known.state.geometry_ids == 1),
        (K, {"instance": []}, False),
    ):
        known.check_points(open_tracer(scene).closest_points(known.points, k, **options), k, seen)


def test_ties_are_in_the_order_of_instances_and_primitives(session):
    mesh = centred(make_shape("icosphere", triangles=80))
    faces = [np.flatnonzero((mesh.faces == vertex).any(axis=1))[:4].tolist() for vertex in range(len(mesh.vertices))]
    for transform in (affine(), affine(random_linear(np.random.default_rng(1470)), (1, 2, 3))):
        scene = Scene()
        scene.place_many(scene.add(mesh), [transform] * 9)
        points = mesh.vertices @ transform[:3, :3].T + transform[:3, 3]
        with Tracer(scene, device=session.info) as tracer:
            closest, nearest = tracer.closest_points(points, 4), tracer.closest_point(points)
        assert closest.prim_id.tolist() == faces
        assert (closest.instance_id == 0).all()
        assert (nearest.instance_id == 0).all()
        if transform[0, 0] == 1:  # float32 resolves the ties
            assert nearest.prim_id.tolist() == [each[0] for each in faces]


def test_shapes_and_what_is_refused(tracer):
    for shape in ((), (0,), (2, 3)):
        closest = tracer.closest_points(np.zeros((*shape, 3)), 2)
        assert closest.distance.shape == closest.geometry_id.shape == closest.instance_id.shape == (*shape, 2)
        assert closest.point.shape == (*shape, 2, 3)
    hidden = tracer.closest_points([[0, 0, 3], [0, 0, 3]], 2, mask=[0, 4])
    np.testing.assert_array_equal(hidden.prim_id >= 0, [[False] * 2, [True] * 2])
    for k in (0, -1, 1.5, True, "2"):
        with pytest.raises(ConfigError, match=r"^k must be an integer of at least 1, not "):
            tracer.closest_points([0, 0, 0], k)
    with pytest.raises(QueryError, match=r"^points\[1\] is not finite: "):
        tracer.closest_points([[0, 0, 0], [0, np.nan, 0]], 3)


@pytest.mark.parametrize(("scale", "shift"), [(1, 0), (1e-100, 0), (1e-30, 1e3), (1e30, 0), (1e100, 1e3)])
def test_the_nearest_vertex_is_the_first_one_at_the_smallest_distance(scale, shift):
    """Those of no face count, too."""
    soup, generator = make_soup(300, seed=71, copies=0.2), np.random.default_rng(72)
    mesh = Mesh.from_arrays((np.append(soup.vertices, [[9, 9, 9]], axis=0) + shift) * scale, soup.faces)
    close = soup.vertices[generator.integers(0, len(soup.vertices), 200)] + generator.normal(0, 1e-2, (200, 3))
    points = (np.concatenate((close, generator.uniform(-2, 9, (200, 3)))) + shift) * scale
    away = np.linalg.norm((points[:, None] - mesh.vertices) / scale, axis=2)
    distance, vertex_id = find_nearest_vertices(build(mesh), points)
    np.testing.assert_allclose(distance / scale, away.min(axis=1), rtol=1e-13)
    np.testing.assert_array_equal(vertex_id, away.argmin(axis=1))
    assert (vertex_id == len(soup.vertices)).any()


def cosines_of(mesh, points):
    """How directly each face that is as near as the nearest one faces each point; -inf for the others."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    cosines = []
    for point in points:
        ways = point - trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
        squared = (ways**2).sum(axis=1)
        cosine = (ways * normals).sum(axis=1) / np.sqrt(squared)
        cosines.append(np.where(squared < squared.min() + TOLERANCE, cosine, -np.inf))
    return np.array(cosines)


@pytest.mark.parametrize("shape", ["boxes", "blobs"])
def test_no_face_faces_more_directly(session, shape):
    mesh = make_shape(shape, triangles=300)
    if shape == "boxes":  # of which no two triangles share a vertex
        mesh = Mesh.from_arrays(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * mesh.face_count).reshape(-1, 3))
    points = mesh.origin + np.random.default_rng(75).uniform(-1, 1, (500, 3)) * np.ptp(mesh.vertices, axis=0).max()
    with Tracer(mesh, device=session.info) as tracer:
        found = tracer.closest_point(points)
    chosen, cosines = ClosestPoints(*(array.copy() for array in found)), cosines_of(mesh, points)
    choose_facing(points, mesh, mesh.corner_faces.widened(), TOLERANCE, chosen)
    np.testing.assert_allclose(cosines[np.arange(500), chosen.prim_id], cosines.max(axis=1), atol=1e-6)
    np.testing.assert_allclose(chosen.distance, found.distance, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(points - chosen.point, axis=1), chosen.distance, rtol=1e-9)
    # The test can fail: the device's choice is another one.
    assert (cosines[np.arange(500), found.prim_id] < cosines.max(axis=1) - 1e-3).sum() > 10
