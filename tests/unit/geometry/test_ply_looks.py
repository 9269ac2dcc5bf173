"""Looks in PLY files: attributes of vertices and faces, and textures; those that cannot be used are dropped."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from PIL import Image

import clbvh

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0.0]])
# A quad and a triangle: the corners of the triangles that are cut from them.
POLYGONS = [[0, 1, 2, 3], [2, 1, 0]]
CUT = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0]])
TILTED = np.array([[0, 0, 2], [3, 0, 4], [0, 1, 0], [-1, 0, 0.0]])
UNIT = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 1, 0], [-1, 0, 0]])
COLOURS = np.array([[10, 20, 30, 40], [50, 60, 70, 80], [90, 100, 110, 120], [255, 0, 255, 0]])
UVS = np.array([[0, 0], [1, 0], [1, 0.5], [0, 2.5]])


def write(path, properties, columns, *, face_properties=(), face_rows=(), kind="ascii", polygons=POLYGONS, comments=()):
    """Write a PLY file with more columns behind x, y and z, and more numbers behind the corners of faces."""
    lines = ["ply", f"format {kind} 1.0", *comments, f"element vertex {len(SQUARE)}"]
    lines += [f"property float {axis}" for axis in "xyz"] + [f"property {line}" for line in properties]
    lines += [f"element face {len(polygons)}", "property list uchar int vertex_indices"]
    lines += [f"property {line}" for line in face_properties]
    content = ("\n".join([*lines, "end_header"]) + "\n").encode()
    columns = np.asarray(columns, float).reshape(len(SQUARE), -1)
    rows = face_rows or [[]] * len(polygons)
    if kind == "ascii":
        body = [" ".join(f"{number:g}" for number in row) for row in np.column_stack((SQUARE, columns))]
        body += [" ".join(f"{x:g}" for x in [len(one), *one, *row]) for one, row in zip(polygons, rows, strict=True)]
        path.write_bytes(content + "\n".join(body).encode() + b"\n")
        return path
    order = "<" if kind == "binary_little_endian" else ">"
    types = {"float": "f4", "uchar": "u1", "ushort": "u2", "double": "f8"}
    dtypes = [f"{order}{types[line.split()[0]]}" for line in properties]
    for vertex, row in zip(SQUARE, columns, strict=True):
        content += vertex.astype(f"{order}f4").tobytes()
        content += b"".join(np.array(x).astype(dtype).tobytes() for x, dtype in zip(row, dtypes, strict=True))
    for one in polygons:
        content += bytes([len(one)]) + np.array(one, f"{order}i4").tobytes()
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("polygons", [POLYGONS, CUT.tolist()], ids=["polygons", "triangles"])
def test_values_of_vertices_follow_the_corners(tmp_path, kind, polygons):
    properties = [f"float {name}" for name in ("nx", "ny", "nz")]
    properties += [f"uchar {name}" for name in ("red", "green", "blue", "alpha")]
    properties += ["float s", "float t"]
    path = tmp_path / "a.ply"
    write(path, properties, np.column_stack((TILTED, COLOURS, UVS)), kind=kind, polygons=polygons)
    looks = clbvh.load_mesh(path).appearance
    np.testing.assert_allclose(looks.normals, UNIT[CUT], atol=1e-7)
    np.testing.assert_array_equal(looks.colours, COLOURS[CUT])
    np.testing.assert_array_equal(looks.uvs, np.float32(UVS)[CUT])
    assert [material.base_colour for material in looks.materials] == [(1.0, 1.0, 1.0)]
    assert looks.material_ids is None
    assert (looks.normals.dtype, looks.uvs.dtype, looks.colours.dtype) == (np.float32, np.float32, np.uint8)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize(("kind_of_number", "most"), [("uchar", 255), ("ushort", 65535), ("float", 1), ("double", 1)])
def test_colours_of_any_type_are_shares_of_the_greatest(tmp_path, kind, kind_of_number, most):
    shares = np.array([[0, 0.2, 0.4], [0.6, 0.8, 1], [1, 1, 0], [0, 0, 0]])
    properties = [f"{kind_of_number} {name}" for name in ("diffuse_red", "diffuse_green", "diffuse_blue")]
    looks = clbvh.load_mesh(write(tmp_path / "a.ply", properties, shares * most, kind=kind)).appearance
    np.testing.assert_array_equal(looks.colours[..., :3], np.rint(shares * 255)[CUT])
    assert (looks.colours[..., 3] == 255).all()


def test_floats_up_to_255_are_bytes(tmp_path):
    looks = clbvh.load_mesh(write(tmp_path / "a.ply", ["float red", "float green", "float blue"], COLOURS[:, :3]))
    np.testing.assert_array_equal(looks.appearance.colours[..., :3], COLOURS[CUT][..., :3])


def test_colours_and_coordinates_of_faces_follow_the_cut(tmp_path):
    rows = [[8, 0, 0, 1, 0, 1, 1, 0, 1, 11, 12, 13], [6, 5, 5, 6, 5, 6, 6, 21, 22, 23]]
    properties = ["list uchar float texcoord", "uchar red", "uchar green", "uchar blue"]
    path = write(tmp_path / "a.ply", [], np.zeros((4, 0)), face_properties=properties, face_rows=rows)
    looks = clbvh.load_mesh(path).appearance
    quad, triangle = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), [[5, 5], [6, 5], [6, 6]]
    np.testing.assert_array_equal(looks.uvs, [quad[[0, 1, 2]], quad[[0, 2, 3]], triangle])
    np.testing.assert_array_equal(looks.colours[:, :, 0], [[11] * 3, [11] * 3, [21] * 3])


def test_faces_without_coordinates_have_none_of_their_neighbours(tmp_path):
    rows = [[0], [6, 5, 5, 6, 5, 6, 6]]
    path = write(
        tmp_path / "a.ply", [], np.zeros((4, 0)), face_properties=["list uchar float texcoord"], face_rows=rows
    )
    uvs = clbvh.load_mesh(path).appearance.uvs
    np.testing.assert_array_equal(uvs, [[[0, 0]] * 3, [[0, 0]] * 3, [[5, 5], [6, 5], [6, 6]]])


def test_a_texture_is_read_from_beside_the_file(tmp_path):
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    Image.fromarray(pixels).save(tmp_path / "my tiles.PNG")
    comments = ["comment TextureFile my tiles.png"]  # of another case than the file
    path = write(tmp_path / "a.ply", ["float u", "float v"], UVS, comments=comments)
    (material,) = clbvh.load_mesh(path).appearance.materials
    np.testing.assert_array_equal(material.base_colour_texture.pixels[..., :3], pixels)
    assert material.base_colour_texture.is_srgb
    assert material.base_colour == (1.0, 1.0, 1.0)


def test_faces_choose_among_textures(tmp_path):
    for number in range(2):
        Image.new("RGB", (1, 1), (number, 0, 0)).save(tmp_path / f"{number}.png")
    path = write(
        tmp_path / "a.ply",
        ["float u", "float v"],
        UVS,
        comments=["comment TextureFile 0.png", "comment TextureFile 1.png"],
        face_properties=["int texnumber"],
        face_rows=[[1], [-1]],
    )
    looks = clbvh.load_mesh(path).appearance
    assert looks.material_ids.tolist() == [1, 1, 2]
    assert looks.materials[1].base_colour_texture.pixels[0, 0, 0] == 1
    assert looks.materials[2].base_colour_texture is None


@pytest.mark.parametrize(
    ("properties", "columns", "message"),
    [
        (
            ["float nx", "float ny", "float nz"],
            np.full((4, 3), np.nan),
            "normals cannot be used: some are not",
        ),
        (["float s", "float t"], np.full((4, 2), np.inf), "texture coordinates cannot be used: some are not finite"),
        (
            ["float red", "float green", "float blue"],
            np.full((4, 3), np.nan),
            "colours cannot be used: a colour is not",
        ),
    ],
    ids=["normals", "uvs", "colours"],
)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_attributes_that_are_no_numbers_are_dropped_with_one_warning(tmp_path, properties, columns, message):
    path = write(tmp_path / "a.ply", properties, columns, kind="binary_little_endian")
    with pytest.warns(clbvh.AppearanceWarning, match=message) as caught:
        mesh = clbvh.load_mesh(path)
    assert len(caught) == 1
    assert str(caught[0].message).startswith(f"{path}: ")
    assert caught[0].filename == __file__
    assert mesh.face_count == 3
    assert mesh.appearance is None


def test_normals_of_no_length_are_those_of_the_faces(tmp_path):
    path = write(tmp_path / "a.ply", ["float nx", "float ny", "float nz"], TILTED * [[0], [1], [1], [1]])
    normals = clbvh.load_mesh(path).appearance.normals
    expected = UNIT[CUT]
    expected[0, 0] = expected[1, 0] = [0, 0, 1]
    expected[2, 2] = [0, 0, -1]
    np.testing.assert_allclose(normals, expected, atol=1e-7)


@pytest.mark.parametrize("name", ["lost.png", "..", "/dev/zero", "\0", "a.ply", "x" * 5000])
def test_a_texture_that_cannot_be_read_is_one_warning(tmp_path, name):
    path = write(tmp_path / "a.ply", ["float u", "float v"], UVS, comments=[f"comment TextureFile {name}"])
    with pytest.warns(clbvh.AppearanceWarning, match="the texture ") as caught:
        looks = clbvh.load_mesh(path).appearance
    assert len(caught) == 1
    assert looks.materials[0].base_colour_texture is None
    assert looks.uvs is not None


def test_a_file_without_looks_has_none(tmp_path):
    assert clbvh.load_mesh(write(tmp_path / "a.ply", ["float quality"], np.ones(4))).appearance is None


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_what_trimesh_writes_is_read(tmp_path, encoding):
    ball = trimesh.creation.icosphere(subdivisions=2)
    colours = np.random.default_rng(0).integers(0, 256, (len(ball.vertices), 4), np.uint8)
    ball.visual = trimesh.visual.ColorVisuals(ball, vertex_colors=colours)
    ball.export(tmp_path / "a.ply", encoding=encoding, vertex_normal=True)
    mesh = clbvh.load_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.appearance.colours, colours[mesh.faces])
    np.testing.assert_allclose(mesh.appearance.normals, ball.vertex_normals[mesh.faces], atol=1e-5)
