"""The mesh: checks, local coordinates, degenerate triangles, parts, and whether it encloses a volume."""

import copy
import pickle
import warnings

import numpy as np
import pytest
import trimesh

from clbvh import Appearance, ConfigError, Material, Mesh, MeshError, Part, Transform, load_mesh
from clbvh.geometry import mesh as mesh_module, topology
from clbvh.geometry.spheres import with_material
from clbvh.geometry.topology import find_equal_points, find_points

TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
CORNERS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
FACES = [[0, 1, 2], [0, 2, 3], [0, 1, 3]]
PARTS = (Part("left", 0, 2), Part("right", 2, 3))
BALL = trimesh.creation.icosphere(subdivisions=3)
SOUP = np.arange(BALL.faces.size).reshape(-1, 3)


def test_vertices_are_kept_and_once_more_around_zero_and_about_1_in_size():
    vertices = [[10, 20, 30], [14, 20, 30], [10, 26, 38]]
    mesh = Mesh.from_arrays(vertices, [[0, 1, 2]])
    assert (mesh.origin.tolist(), mesh.scale) == ([12, 23, 34], 0.125)
    assert (mesh.local_vertices * 8).tolist() == [[-2, -3, -4], [2, -3, -4], [-2, 3, 4]]
    assert (mesh.vertices.dtype, mesh.local_vertices.dtype, mesh.faces.dtype) == (np.float64, np.float32, np.int32)
    assert (mesh.to_local(vertices) == mesh.local_vertices).all()
    flat = Mesh.from_arrays(np.full((3, 3), 7.5), [[0, 1, 2]])
    assert (flat.scale, flat.local_vertices.any()) == (1, False)


@pytest.mark.parametrize("exponent", [-495, -149, -1, 23, 495])
def test_local_coordinates_have_the_same_bits_in_every_unit(exponent):
    vertices = np.random.default_rng(0).normal(size=(50, 3))
    mesh, scaled = (Mesh.from_arrays(vertices * unit, [[0, 1, 2]]) for unit in (1, 2.0**exponent))
    assert scaled.local_vertices.tobytes() == mesh.local_vertices.tobytes()
    assert scaled.scale == mesh.scale * 2.0**-exponent
    assert 0.5 <= np.abs(mesh.local_vertices).max() <= 1


@pytest.mark.parametrize("count", [3, 511, 512, 513, 1024, 1500])
def test_the_box_is_right_wherever_the_outermost_vertex_is(count):
    for place in {0, 1, count // 2, count - 1}:
        vertices = np.zeros((count, 3))
        vertices[place] = [-2, 4, 6]
        faces = np.resize(np.arange(count), (count, 3))
        assert Mesh.from_arrays(vertices, faces).origin.tolist() == [-1, 2, 3]


def test_arrays_of_any_type_are_copied():
    for dtype in (np.float16, np.float32, np.longdouble, np.int8, np.uint32):
        assert Mesh.from_arrays(np.array(TRIANGLE, dtype), [[0, 1, 2]]).vertices.tolist() == TRIANGLE
    wide = np.random.default_rng(0).random((1200, 6))[::2, 1::2]
    assert (Mesh.from_arrays(wide, [[0, 1, 2]]).vertices == wide).all()
    vertices, faces = np.array(TRIANGLE), np.array([[0, 1, 2]], np.int32)
    mesh = Mesh.from_arrays(vertices, faces)
    vertices[:] = faces[:] = 7
    assert (mesh.vertices.tolist(), mesh.faces.tolist()) == (TRIANGLE, [[0, 1, 2]])


def test_bad_arrays_are_refused_by_name():
    signalling = np.array(TRIANGLE, np.float32)
    signalling.view(np.uint32)[2, 1] = 0x7FA00000
    for vertices, faces, message in (
        (np.zeros((0, 3)), FACES, "no vertices"),
        ([["a", "b", "c"]], FACES, "must be numbers"),
        (TRIANGLE, [[0.0, 1.0, 2.0]], "must be integers"),
        (TRIANGLE, [[0, 1, 2], [0, 1, 3]], r"face 1 refers to vertex 3, .*\(0 to 2\)"),
        (TRIANGLE, [[0, 1, 2], [0, -1, 2]], "face 1 refers to vertex -1"),
        (signalling, [[0, 1, 2]], "vertex 2 has a coordinate .*not finite: y = nan"),
        (np.array(TRIANGLE) * 1e160, [[0, 1, 2]], "5e.159 units wide .*in another unit"),
        (np.array(TRIANGLE) * 1e-160, [[0, 1, 2]], "less than 3e-151 or more than 3e.150"),
        ([[-1.5e308, 0, 0], [1.5e308, 0, 0], [0, 1, 0]], [[0, 1, 2]], "1.5e.308 units wide"),
    ):
        with pytest.raises(MeshError, match=f"^thing: .*{message}"):
            Mesh.from_arrays(vertices, faces, name="thing")
    for vertices, message in (
        (TRIANGLE[:2], "2 vertices cannot replace the mesh's 3"),
        (signalling, "vertex 2 .*not finite: y = nan"),
    ):
        with pytest.raises(MeshError, match=f"^thing: .*{message}"):
            Mesh.from_arrays(TRIANGLE, [[0, 1, 2]], name="thing").with_vertices(vertices)


def test_degenerate_triangles_are_kept_and_found():
    faces = [[0, 1, 2], [0, 0, 0], [0, 1, 3], [0, 1, 4], [2, 2, 1], [0, 2, 1], [1, 2, 0], [1, 2, 4], [3, 3, 0]]
    mesh = Mesh.from_arrays([*TRIANGLE, [3, 0, 0], [0.1, 0.1, 0.1]], faces)
    assert np.flatnonzero(mesh.degenerate_faces).tolist() == [1, 2, 4, 8]
    assert (mesh.degenerate_count, mesh.face_count) == (4, 9)


def test_equal_points_are_found_as_a_dictionary_would(monkeypatch):
    for factors in (topology.FACTORS, np.array([1, 1, 1], np.uint64)):  # the second gives many the same key
        monkeypatch.setattr(topology, "FACTORS", factors)
        for dtype in (np.float32, np.float64):
            points = np.random.default_rng(0).integers(0, 4, (200, 3)).astype(dtype) / 3
            numbers: dict[bytes, int] = {}
            expected = [numbers.setdefault(point.tobytes(), len(numbers)) for point in points]
            first, ids = find_equal_points(points)
            assert ids.tolist() == expected
            assert first.tolist() == [expected.index(number) for number in range(len(numbers))]
    points = np.array([[0, 0, 1], [-0.0, 0, 1], [0, 0, np.nextafter(1, 2)], [0, 0, 1], [1, 0, 0]])
    assert find_equal_points(points).ids.tolist() == [0, 1, 2, 0, 3]
    assert find_points(points).ids.tolist() == [0, 0, 1, 0, 2]
    assert find_equal_points(points[:0]).ids.shape == (0,)


def test_a_closed_surface_is_watertight_however_it_is_listed():
    corners, turned = BALL.vertices[BALL.faces].reshape(-1, 3), BALL.faces.copy()
    turned[::3] = turned[::3, ::-1]
    degenerate = [*BALL.faces, [0, 0, 1], [2, 2, 2]]
    rows = [(BALL.vertices * size, BALL.faces, True) for size in (1e-100, 1, 1e100)]
    rows += [(BALL.vertices, turned, True), (corners, SOUP, True), (BALL.vertices, degenerate, True)]
    rows += [(BALL.vertices, degenerate[1:], False), (BALL.vertices, np.delete(BALL.faces, 100, axis=0), False)]
    rows += [(CORNERS, [[0, 1, 2], [0, 2, 1]], True), (CORNERS, [[0, 1, 2], [0, 2, 1], [1, 2, 0]], False)]
    rng = np.random.default_rng(0)
    faces = np.array([face for face in rng.integers(0, 12, (40, 3)) if len(set(face)) == 3])
    # Every triangle of a random set becomes the four of a tetrahedron over a new vertex.
    closed = np.concatenate([[[a, b, c], [a, b, 12], [b, c, 12], [c, a, 12]] for a, b, c in faces])
    rows += [(rng.normal(size=(13, 3)), faces, False), (rng.normal(size=(13, 3)), closed, True)]
    for vertices, faces, expected in rows:
        assert Mesh.from_arrays(vertices, faces).is_watertight == expected, faces[:3]


def test_joined_faces_stay_closed_however_vertices_move_and_are_not_tested_again(monkeypatch):
    tested, is_closed = [], topology.is_closed
    monkeypatch.setattr(mesh_module, "is_closed", lambda faces: tested.append(len(faces)) or is_closed(faces))
    mesh = Mesh.from_arrays(BALL.vertices, BALL.faces)
    for factor in (1, 0, [1, 0, 1], 1e9):
        mesh = mesh.with_vertices(BALL.vertices * factor)
        assert mesh.is_watertight
    assert tested == [len(BALL.faces)]
    # A hole may be closed by moving, and corners that are listed for each triangle may be torn.
    torn = BALL.vertices[BALL.faces].reshape(-1, 3)
    soup = Mesh.from_arrays(torn, SOUP)
    torn[0] *= 1.5
    assert (soup.is_watertight, soup.with_vertices(torn).is_watertight) == (True, False)
    open_mesh = Mesh.from_arrays(BALL.vertices, BALL.faces[1:])
    closed = BALL.vertices.copy()
    closed[BALL.faces[0]] = closed[BALL.faces[0, 0]]
    assert (open_mesh.is_watertight, open_mesh.with_vertices(closed).is_watertight) == (False, True)


def make_square(parts=PARTS):
    return Mesh.from_arrays(CORNERS, FACES, parts=parts)


def test_parts_cover_the_faces_one_after_the_other():
    for parts, message in (
        ([("a", 1, 3)], r"the part 'a' has the faces 1 to 3, but the part before it ends at 0"),
        ([("a", 0, 2), ("b", 1, 3)], r"the part 'b' has the faces 1 to 3, but the part before it ends at 2"),
        ([("a", 0, 4)], r"the part 'a' has the faces 0 to 4, .* and the mesh has 3 faces"),
        ([("a", 0, 2)], r"the parts end at face 2, but the mesh has 3 faces"),
        (5, r"parts must be a sequence of clbvh\.Part"),
    ):
        with pytest.raises(MeshError, match=message):
            make_square(parts)


def test_parts_stay_where_faces_stay():
    mesh = make_square()
    moved = mesh.with_vertices(mesh.vertices * 2), with_material(mesh, Material("red")), Transform(scale=2).apply(mesh)
    for kept in (*moved, copy.deepcopy(mesh), pickle.loads(pickle.dumps(mesh))):
        assert kept.parts == PARTS


@pytest.mark.parametrize("unit", [1.0, 1e-140, 1e140])
def test_measures_are_those_of_formulas_in_any_unit(unit):
    box = Mesh.from_arrays(trimesh.creation.box((2, 3, 4)).vertices * unit, trimesh.creation.box().faces)
    np.testing.assert_allclose(box.bounds, np.array([[-1, -1.5, -2], [1, 1.5, 2]]) * unit)
    assert box.area / unit / unit == pytest.approx(52)
    np.testing.assert_allclose(box.face_normals, trimesh.creation.box((2, 3, 4)).face_normals, atol=1e-15)
    flat = Mesh.from_arrays([*TRIANGLE, [2, 0, 0]], [[0, 1, 2], [0, 1, 3]])
    assert (flat.face_normals.tolist(), flat.area) == ([[0, 0, 1], [0, 0, 0]], 0.5)


def test_areas_of_needles_and_specks_are_exact_to_their_last_digits():
    x, y, thin, small = 1 / 7, 1 / 3, 2.0**-40, 1e-100
    corners = [[0, 0, 0], [x, y, 0], [x, y + thin, 0], [small, 0, 0], [0, small, 0]]
    mesh = Mesh.from_arrays(corners, [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 3, 4]])
    np.testing.assert_allclose(mesh.face_areas, [x * thin / 2] * 3 + [small**2 / 2], rtol=1e-15)


@pytest.mark.parametrize(("suffix", "unit", "shift"), [(".ply", 1e-9, 7e6), (".OBJ", 1e-9, 7e6), (".stl", 1.0, 0.0)])
def test_a_saved_mesh_is_loaded_as_it_was(tmp_path, suffix, unit, shift):
    generator = np.random.default_rng(0)
    vertices = generator.normal(size=(60, 3)).astype(np.float32) * unit + shift * generator.random((60, 3))
    mesh = Mesh.from_arrays(vertices, np.arange(60).reshape(-1, 3))
    mesh.save(tmp_path / f"mesh{suffix}")
    loaded = load_mesh(tmp_path / f"mesh{suffix}")
    assert loaded.vertices[loaded.faces].tobytes() == mesh.vertices[mesh.faces].tobytes()
    if suffix == ".stl":  # others compute nothing of them
        np.testing.assert_allclose(trimesh.load(tmp_path / "mesh.stl").face_normals, mesh.face_normals, atol=1e-6)
    with pytest.raises(ConfigError, match=r"must end in \.obj, \.ply, \.stl"):
        mesh.save(tmp_path / "mesh.gltf")


class TestLooksOfSavedMeshes:
    CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    FACES = np.array([[0, 1, 2], [0, 2, 3]])

    def save(self, tmp_path, suffix, looks, **named):
        mesh = Mesh.from_arrays(self.CORNERS, self.FACES, appearance=Appearance(**looks), **named)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            mesh.save(tmp_path / f"mesh{suffix}")
            loaded = load_mesh(tmp_path / f"mesh{suffix}")
        return mesh, loaded, " ".join(str(each.message) for each in caught)

    @pytest.mark.parametrize("suffix", [".ply", ".obj"])
    def test_what_a_vertex_has_is_loaded_as_it_was(self, tmp_path, suffix):
        generator = np.random.default_rng(3)
        colours = generator.integers(0, 256, (4, 4), np.uint8)
        colours[:, 3] = 255
        looks = {
            "colours": colours[self.FACES],
            "normals": generator.normal(size=(4, 3))[self.FACES],
            "uvs": generator.random((2, 3, 2)),
            "materials": [Material(base_colour=(1, 1, 1))],
        }
        mesh, loaded, told = self.save(tmp_path, suffix, looks)
        assert told == ""
        assert (loaded.vertices == mesh.vertices).all()
        assert (loaded.faces == mesh.faces).all()
        assert loaded.appearance.colours.tobytes() == mesh.appearance.colours.tobytes()
        assert loaded.appearance.uvs.tobytes() == mesh.appearance.uvs.tobytes()
        np.testing.assert_allclose(loaded.appearance.normals, mesh.appearance.normals, atol=1e-6)

    def test_colours_of_faces_are_kept_where_the_format_has_them(self, tmp_path):
        looks = {"colours": np.repeat(np.array([[[255, 0, 0, 9]], [[0, 255, 0, 255]]], np.uint8), 3, axis=1)}
        mesh, loaded, told = self.save(tmp_path, ".ply", looks)
        assert (loaded.appearance.colours == mesh.appearance.colours).all()
        assert told == ""
        for suffix, words in ((".obj", "colours that differ at a vertex and alpha"), (".stl", "colours")):
            assert f"does not keep {words}: clbvh.Scene(mesh).save" in self.save(tmp_path, suffix, looks)[2]

    def test_materials_and_parts_are_named_where_they_are_lost(self, tmp_path):
        looks, parts = (
            {"materials": [Material("gold", metallic=1)]},
            (Part("one", 0, 1), Part("two", 1, 2)),
        )
        _, loaded, told = self.save(tmp_path, ".obj", looks, parts=parts)
        assert [part.name for part in loaded.parts] == ["one", "two"]
        assert "does not keep materials:" in told
        assert "does not keep materials and parts:" in self.save(tmp_path, ".ply", looks, parts=parts)[2]


def test_a_trimesh_has_arrays_of_its_own():
    mesh = Mesh.from_arrays(BALL.vertices, BALL.faces)
    copied = mesh.to_trimesh()
    assert (copied.triangles == mesh.vertices[mesh.faces]).all()
    copied.vertices[:] = 0
    assert mesh.vertices.any()
