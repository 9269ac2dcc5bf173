"""The inside of meshes whose faces coincide: that of the solids they enclose, by formula."""

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, OpenMeshWarning, Scene, Spheres, Tracer, Transform
from clbvh.integrations.trimesh import ProximityQuery, RayMeshIntersector, SceneRay

BOX = trimesh.creation.box()
POINTS = np.random.default_rng(200).uniform(-1.6, 1.6, (300, 3))

# The same cube on the other side of x = 0.5, whose wall there is cut along the same diagonal; and one that is not.
FACES, BEHIND = BOX.faces, np.add(BOX.vertices, (1, 0, 0))
MIRRORED = BOX.vertices * [-1, 1, 1] + [1, 0, 0], FACES[:, ::-1]


def join(*parts):
    """A mesh of vertices and faces that follow each other; parts without faces have those of the cube."""
    parts = [part if isinstance(part, tuple) else (part, FACES) for part in parts]
    begins = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [np.asarray(faces) + begin for (_, faces), begin in zip(parts, begins, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def cubes(*centres, half=0.5):
    return (np.abs(POINTS[:, None] - np.reshape(centres, (-1, 3))) < half).all(axis=2).any(axis=1)


BOTH = BOX.vertices, np.concatenate([FACES, FACES[:, ::-1]])
BACK = BOX.vertices, FACES[:, ::-1]
ONE, TWO = cubes([0, 0, 0]), cubes([0, 0, 0], [1, 0, 0])
THREE = cubes([-2, 0, 0], [0, 0, 0], [1.25, 0, 0])
SHIFTED = BOX.vertices + 0.5 - 0.5 + 0.0
CASES = {
    "both sides": (BOTH, ONE),
    "the same side": ((BOX.vertices, np.repeat(FACES, 2, axis=0)), ONE),
    "other first corners": ((BOX.vertices, np.concatenate([FACES, np.roll(FACES, 1, axis=1)])), ONE),
    "vertices of their own": (join(BOX.vertices, BACK), ONE),
    "no shared vertices": ((BOX.vertices[BOTH[1]].reshape(-1, 3), np.arange(72).reshape(-1, 3)), ONE),
    "three": (join(BOX.vertices, BACK, BOX.vertices), ONE),
    "four": (join(BOX.vertices, BACK, BOX.vertices, BACK), ONE),
    "a part": ((BOX.vertices, np.concatenate([FACES, FACES[3:5]])), ONE),
    "a part three times": ((BOX.vertices, np.concatenate([FACES, FACES[3:5], FACES[3:5, ::-1]])), ONE),
    "a wall": (join(BOX.vertices, MIRRORED), TWO),
    "a wall, all doubled": (join(BOX.vertices, MIRRORED, BACK, MIRRORED), TWO),
    "a wall cut otherwise": (join(BOX.vertices, BEHIND), TWO),
    "doubled beside others": (join(BOX.vertices - [2, 0, 0], BOTH, BEHIND + np.array([0.25, 0, 0])), THREE),
    "a hollow": (join(BOTH, (BOX.vertices * 0.5, BOTH[1])), ONE & ~cubes([0, 0, 0], half=0.25)),
    "a point and a line": ((BOX.vertices, [*BOTH[1], [0, 0, 0], [0, 0, 1], [1, 0, 0]]), ONE),
    "signs of zero": (join(SHIFTED, np.where(SHIFTED == 0, -0.0, SHIFTED)), ONE),
}


@pytest.mark.parametrize("name", CASES)
def test_the_inside_is_that_of_the_solid(session, name):
    (vertices, faces), expected = CASES[name]
    matrix = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [0, 0, 0])
    matrix[:3, 3] = [100, -20, 3]
    scene = Scene()
    other, doubled = scene.add(BOTH), scene.add((vertices, faces))
    balls = scene.add(Spheres([[0, 0, 0]], 0.5))
    scene.place(other, Transform(translate=[0, 50, 0]))
    placed, again = scene.place(doubled, matrix), scene.place(doubled, matrix @ Transform(translate=[0, 0, 9]).matrix)
    scene.place(balls, Transform(translate=[0, -50, 0]))
    there = trimesh.transform_points(POINTS, matrix)
    with Tracer((vertices, faces), device=session.info) as tracer, Tracer(scene, device=session.info) as in_scene:
        assert tracer.mesh.is_watertight
        distance = np.where(expected, 1, -1) * tracer.closest_point(POINTS).distance
        assert (tracer.contains(POINTS) == expected).all()
        assert (tracer.contains(POINTS, mask=np.arange(300) % 2) == expected & (np.arange(300) % 2 > 0)).all()
        np.testing.assert_array_equal(tracer.signed_distance(POINTS), distance)
        for options in ({}, {"instance": placed}, {"geometry": doubled}):
            assert (in_scene.contains(there, **options) == expected).all()
            np.testing.assert_allclose(in_scene.signed_distance(there, **options), distance, atol=1e-9)
        assert not in_scene.contains(there, instance=again).any()
        assert in_scene.contains([[0, 50, 0], [0, -50, 0], [0, 51, 0]]).tolist() == [True, True, False]
    copied = trimesh.Trimesh(vertices, faces, process=False)
    assert (RayMeshIntersector(copied).contains_points(POINTS) == expected).all()
    aside = BOX.copy().apply_translation([9, 0, 0])
    assert (SceneRay(trimesh.Scene([aside, copied])).contains_points(POINTS) == expected).all()
    if name != "a wall cut otherwise":  # by normals, as in trimesh
        np.testing.assert_allclose(ProximityQuery(copied).signed_distance(POINTS), distance, atol=1e-12)


@pytest.mark.parametrize("layout", ["bvh2", "bvh4", "bvh8"])
@pytest.mark.parametrize("seed", [0, 1])
def test_solids_that_are_there_several_times(session, layout, seed):
    """Tetrahedra apart from each other, each with its own number of copies, which list corners in any order."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.5, 0.5, (40, 4, 3)) + 2 * np.argwhere(np.ones((4, 5, 2)))[:, None]
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
    copies = rng.integers(1, 5, len(corners))
    soup = np.repeat(corners, copies, axis=0)[:, faces].reshape(-1, 3, 3)
    orders = rng.permuted(np.tile(np.arange(3), (len(soup), 1)), axis=1)
    soup = rng.permutation(np.take_along_axis(soup, orders[..., None], axis=1)).reshape(-1, 3)
    within = (rng.dirichlet(np.ones(4), (40, 20))[..., None] * corners[:, None]).sum(axis=2)
    points = np.concatenate([within.reshape(-1, 3), rng.uniform(-0.5, 9, (1000, 3))])
    weights = np.linalg.solve(
        np.concatenate([corners.transpose(0, 2, 1), np.ones((40, 1, 4))], axis=1),
        np.broadcast_to(np.column_stack([points, np.ones(len(points))]).T, (40, 4, len(points))),
    )
    expected = (weights > 0).all(axis=1).any(axis=0)
    assert expected[: within.size // 3].all()
    with Tracer((soup, np.arange(len(soup)).reshape(-1, 3)), device=session.info, layout=layout) as tracer:
        assert (tracer.contains(points) == expected).all()


def test_copies_that_come_to_lie_on_each_other_and_part_again(session):
    vertices, faces = join(BOX.vertices, np.add(BOX.vertices, (4, 0, 0)))
    scene = Scene()
    pair = scene.add((vertices, faces))
    scene.place(pair)
    scene.place(scene.add(Spheres([[0, 0, 50]], 1)))
    with Tracer((vertices, faces), device=session.info) as tracer, Tracer(scene, device=session.info) as in_scene:
        for way in (4, 0, 4, 0):
            moved = np.concatenate([BOX.vertices, np.add(BOX.vertices, (way, 0, 0))])
            tracer.update(moved)
            in_scene.set_vertices(pair, moved)
            for each in (tracer, in_scene):
                assert (each.contains(POINTS) == ONE).all()
                assert each.contains([way, 0.1, 0.2]).all()


WARNINGS = {
    "counts each of them": join(BOX.vertices, BOX.vertices + 1e-9),
    "encloses nothing": (BOX.vertices, np.concatenate([FACES[1:], FACES[1:, ::-1]])),
    "is not closed": (BOX.vertices, np.concatenate([FACES[1:], FACES[3:5]])),
}


@pytest.mark.parametrize("words", WARNINGS)
def test_what_is_not_promised_is_told(session, words):
    with Tracer(WARNINGS[words], device=session.info) as tracer:
        with pytest.warns(OpenMeshWarning, match=words) as caught:
            tracer.contains(POINTS)
        assert (len(caught), caught[0].filename) == (1, __file__)
        tracer.signed_distance(POINTS)


def test_small_faces_in_one_cell_and_thin_plates_are_no_copies():
    """Faces that float32 confounds at the size of the mesh: of a ball far from a cube; and a plate of 1e-6."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    for far in (1e6, 2e7, 1e8):
        mesh = Mesh.from_arrays(*join((ball.vertices, ball.faces), np.add(BOX.vertices, (far, 0, 0))))
        assert (len(mesh.coincidence.faces), mesh.coincidence.has_shifted) == (0, False)
    assert not Mesh.from_arrays(BOX.vertices * [1, 1, 1e-6], FACES).coincidence.has_shifted


def test_normals_at_vertices_are_those_of_faces_that_are_there_once():
    expected = Mesh.from_arrays(BOX.vertices, FACES).vertex_normals
    for vertices, faces in (BOTH, join(BOX.vertices, BACK), (BOX.vertices, [*FACES, *FACES[:3], *FACES[:2]])):
        found = Mesh.from_arrays(vertices, faces).vertex_normals
        np.testing.assert_allclose(found, np.tile(expected, (len(vertices) // 8, 1)), atol=1e-15)
