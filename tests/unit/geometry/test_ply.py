"""PLY files: polygons and strips, of any type and spacing, their looks; and how polygons are cut."""

import struct

import numpy as np
import pytest
from PIL import Image

import clbvh
from clbvh import AppearanceWarning, MeshError, load_mesh
from clbvh.geometry.loading.polygons import cut_fans
from clbvh.support import memory

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0.0]])
# A quad, a triangle, an edge, and the triangles that are cut from them.
POLYGONS = [[0, 1, 2, 3], [2, 1, 0], [1, 3]]
CUT = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0]])
TILTED = np.array([[0, 0, 2], [3, 0, 4], [0, 1, 0], [-1, 0, 0.0]])
UNIT = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 1, 0], [-1, 0, 0]])
COLOURS = np.array([[10, 20, 30, 40], [50, 60, 70, 80], [90, 100, 110, 120], [255, 0, 255, 0]])
UVS = np.array([[0, 0], [1, 0], [1, 0.5], [0, 2.5]])
CODES = {"float": "f", "double": "d", "int": "i", "uint": "I", "short": "h", "ushort": "H", "uchar": "B"}
KINDS = ["ascii", "binary_little_endian", "binary_big_endian"]


def make_ply(
    polygons=POLYGONS[:2], kind="ascii", *, vertices=SQUARE, types=("float", "uchar", "int"), properties=(),
    columns=None, face_properties=(), face_rows=None, extra=False, element="face", comments=(),
):  # fmt: skip
    """Return a PLY file; `extra` puts properties and elements around those that matter."""
    coordinate, count, index = types
    columns = np.empty((len(vertices), 0)) if columns is None else np.asarray(columns, float)
    lines, rows = ["ply", f"format {kind} 1.0", *comments], []
    if extra:
        lines += ["element camera 1", "property float zoom", "property list uchar short lens"]
        rows += [[("float", 1.5), ("uchar", 2), ("short", -1), ("short", 5)]]
        properties, columns = ["double quality"], np.full((len(vertices), 1), 0.1)
        face_properties, face_rows = ["uchar flag"], [[7]] * len(polygons)
    lines += [f"element vertex {len(vertices)}", *(f"property {coordinate} {axis}" for axis in "xyz")]
    lines += [f"property {each}" for each in properties]
    lines += [f"element {element} {len(polygons)}", f"property list {count} {index} vertex_indices"]
    lines += [f"property {each}" for each in face_properties]
    for vertex, more in zip(vertices, columns, strict=True):
        row = [(coordinate, x) for x in vertex]
        rows.append(row + [(each.split()[0], x) for each, x in zip(properties, more, strict=True)])
    for polygon, more in zip(polygons, face_rows or [[]] * len(polygons), strict=True):
        rows.append([(count, len(polygon)), *((index, corner) for corner in polygon), *(("uchar", x) for x in more)])
    text = "\n".join([*lines, "end_header", ""])
    if kind == "ascii":
        return (text + "".join(" ".join(f"{value:.17g}" for _, value in row) + "\n" for row in rows)).encode()
    order = ">" if kind == "binary_big_endian" else "<"
    values = [(CODES[code], value) for row in rows for code, value in row]
    numbers = [struct.pack(order + code, value if code in "fd" else int(value)) for code, value in values]
    return text.encode() + b"".join(numbers)


@pytest.fixture
def load(tmp_path):
    def load_bytes(content):
        (tmp_path / "a.ply").write_bytes(content)
        return load_mesh(tmp_path / "a.ply")

    return load_bytes


@pytest.mark.parametrize("kind", KINDS)
def test_polygons_are_cut_in_place_whatever_their_types(load, kind):
    mixed = [[0, 1, 2], [0, 1, 2, 3, 3], [1, 1, 1], [3, 2, 1]]
    for extra in (False, True):
        mesh = load(make_ply(mixed, kind, extra=extra))
        assert mesh.faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3], [0, 3, 3], [1, 1, 1], [3, 2, 1]]
        assert mesh.vertices.tolist() == SQUARE.tolist()
    for types in (("double", "int", "uint"), ("int", "ushort", "uchar"), ("short", "uchar", "float")):
        mesh = load(make_ply(kind=kind, types=types).replace(b"vertex_indices", b"vertex_index"))
        assert (mesh.faces.tolist(), mesh.vertices.tolist()) == (CUT.tolist(), SQUARE.tolist()), types


@pytest.mark.parametrize("kind", KINDS[:2])
def test_strips_are_cut_into_triangles(load, kind):
    corners = np.random.default_rng(0).normal(size=(8, 3))
    for strips, faces in (
        ([[0, 1, 2, 3]], [[0, 1, 2], [1, 3, 2]]),
        # A strip ends at -1, and at the end of a list; each begins with its own winding.
        ([[0, 1, 2, 3, -1, 4, 5, 6, 7], [1, 2, 3]], [[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6], [1, 2, 3]]),
        # Triangles with a vertex twice lead round a corner.
        ([[0, 1, 2, 2, 3, 4]], [[0, 1, 2], [2, 4, 3]]),
        ([[-1, 0, 1, -1, 5, 6, 7, -1]], [[5, 6, 7]]),
    ):
        assert load(make_ply(strips, kind, vertices=corners, element="tristrips")).faces.tolist() == faces
    for strips in ([[0, 1], [2, -1, 3]], [[0]], [[1, 1, 1, 1]]):
        with pytest.raises(MeshError, match="no faces"):
            load(make_ply(strips, kind, element="tristrips"))


def test_text_may_be_spaced_and_signed_as_it_likes(load):
    text = make_ply()
    signature = b"element vertex", b"Created by a program, source file:\nelement vertex"
    for old, new in ((b"\n3 ", b"\n 3\t"), (b"\n3 ", b"\n\n3 "), (b"\n", b"\r\n"), (b"\n", b"\r"), signature):
        assert load(text.replace(old, new)).faces.tolist() == CUT.tolist(), new


def test_digits_of_survey_coordinates_survive(load):
    for kind, coordinate in (("ascii", "float"), ("binary_little_endian", "double")):
        far = make_ply(kind=kind, vertices=SQUARE * 1e-3 + [5e6, 6e6, 300], types=(coordinate, "uchar", "int"))
        assert np.ptp(load(far).vertices, axis=0) == pytest.approx([2e-3, 1e-3, 0], abs=2e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_values_of_vertices_follow_the_corners(load, kind):
    properties = [f"float {name}" for name in ("nx", "ny", "nz")]
    properties += [f"uchar {name}" for name in ("red", "green", "blue", "alpha")] + ["float s", "float t"]
    content = make_ply(kind=kind, properties=properties, columns=np.column_stack((TILTED, COLOURS, UVS)))
    looks = load(content).appearance
    np.testing.assert_allclose(looks.normals, UNIT[CUT], atol=1e-7)
    np.testing.assert_array_equal(looks.colours, COLOURS[CUT])
    np.testing.assert_array_equal(looks.uvs, np.float32(UVS)[CUT])
    assert [material.base_colour for material in looks.materials] == [(1.0, 1.0, 1.0)]
    assert (looks.normals.dtype, looks.uvs.dtype, looks.colours.dtype) == (np.float32, np.float32, np.uint8)
    assert load(make_ply(kind=kind, extra=True)).appearance is None


def test_colours_of_any_type_are_shares_of_the_greatest(load):
    shares = np.array([[0, 0.2, 0.4], [0.6, 0.8, 1], [1, 1, 0], [0, 0, 0]])
    for kind, most in (("uchar", 255), ("ushort", 65535), ("float", 1), ("double", 1), ("float", 255)):
        properties = [f"{kind} {name}" for name in ("diffuse_red", "diffuse_green", "diffuse_blue")]
        looks = load(make_ply(kind=KINDS[1], properties=properties, columns=shares * most)).appearance
        np.testing.assert_array_equal(looks.colours[..., :3], np.rint(shares * 255)[CUT])
        assert (looks.colours[..., 3] == 255).all()


def test_values_of_faces_follow_the_cut(load):
    properties = ["list uchar uchar texcoord", "uchar red", "uchar green", "uchar blue"]
    rows = [[8, 0, 0, 1, 0, 1, 1, 0, 1, 11, 12, 13], [6, 5, 5, 6, 5, 6, 6, 21, 22, 23]]
    looks = load(make_ply(face_properties=properties, face_rows=rows)).appearance
    quad, triangle = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), [[5, 5], [6, 5], [6, 6]]
    np.testing.assert_array_equal(looks.uvs, [quad[[0, 1, 2]], quad[[0, 2, 3]], triangle])
    np.testing.assert_array_equal(looks.colours[:, :, 0], [[11] * 3, [11] * 3, [21] * 3])
    # A face without coordinates has none of its neighbour's.
    uvs = load(make_ply(face_properties=properties[:1], face_rows=[[0], rows[1][:7]])).appearance.uvs
    np.testing.assert_array_equal(uvs, [[[0, 0]] * 3, [[0, 0]] * 3, triangle])


def test_faces_choose_among_textures(load, tmp_path):
    for number, name in enumerate(("0.png", "my tiles.PNG")):
        Image.new("RGB", (1, 1), (number, 0, 0)).save(tmp_path / name)
    comments = ["comment TextureFile 0.png", "comment texturefile my tiles.png"]  # of another case than the file
    uvs = {"properties": ["float u", "float v"], "columns": UVS}
    content = make_ply(**uvs, comments=comments, face_properties=["uchar texnumber"], face_rows=[[1], [9]])
    looks = load(content).appearance
    assert looks.material_ids.tolist() == [1, 1, 2]
    assert looks.materials[1].base_colour_texture.pixels[0, 0].tolist() == [1, 0, 0, 255]
    assert looks.materials[1].base_colour_texture.is_srgb
    assert looks.materials[2].base_colour_texture is None
    (alone,) = load(make_ply(**uvs, comments=comments[:1])).appearance.materials
    assert alone.base_colour_texture.pixels[0, 0, 0] == 0


@pytest.mark.filterwarnings("ignore:invalid value")
def test_looks_that_cannot_be_used_are_one_warning_at_the_caller(tmp_path):
    path = tmp_path / "a.ply"
    rows = [(["nx", "ny", "nz"], "normals cannot be used: some are not"), (["s", "t"], "coordinates cannot be used")]
    for names, message in (*rows, (["red", "green", "blue"], "colours cannot be used: a colour is not")):
        columns = np.full((4, len(names)), np.nan)
        path.write_bytes(make_ply(kind=KINDS[1], properties=[f"float {name}" for name in names], columns=columns))
        with pytest.warns(AppearanceWarning, match=message) as caught:
            assert load_mesh(path).appearance is None
        assert [str(each.message).startswith(f"{path}: ") for each in caught] == [True]
        assert caught[0].filename == __file__
    for name in ("lost.png", "..", "/dev/zero", "\0", "a.ply", "x" * 5000):
        comments = [f"comment TextureFile {name}"]
        path.write_bytes(make_ply(properties=["float u", "float v"], columns=UVS, comments=comments))
        with pytest.warns(AppearanceWarning, match="the texture "):
            assert load_mesh(path).appearance.materials[0].base_colour_texture is None


def test_edges_among_the_faces_are_left_out_and_the_others_keep_their_colours(tmp_path):
    red, _, blue = colours = [[255, 0, 0], [0, 255, 0], [0, 0, 255]]
    properties = ["uchar red", "uchar green", "uchar blue"]
    ply = make_ply([POLYGONS[0], POLYGONS[2], POLYGONS[1]], face_properties=properties, face_rows=colours)
    off = b"OFF\n4 3 0\n0 0 0\n2 0 0\n2 1 0\n0 1 0\n4 0 1 2 3 255 0 0\n2 1 3 0 255 0\n3 2 1 0 0 0 255\n"
    for name, content in (("a.ply", ply), ("a.off", off)):
        (tmp_path / name).write_bytes(content)
        with pytest.warns(AppearanceWarning, match=r"1 of 3 faces have fewer than three corners, and are left out$"):
            mesh = load_mesh(tmp_path / name)
        assert mesh.faces.tolist() == CUT.tolist()
        assert mesh.appearance.colours[:, 0, :3].tolist() == [red, red, blue]


def test_triangles_that_do_not_fit_the_memory_are_refused_before_they_are_cut(monkeypatch):
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 1 << 28)
    with pytest.raises(clbvh.MeshError, match="1,999,998 triangles need about 300 MB of memory"):
        cut_fans(np.zeros(2_000_000, np.int64), np.array([2_000_000]))
