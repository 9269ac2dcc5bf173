"""Appearances, materials and textures: checked when they are made, kept by shapes, read from pictures."""

import copy
import io
import pickle
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

import clbvh
from clbvh import MeshError
from clbvh.geometry.appearance.srgb import linear_to_srgb, srgb_to_linear, to_bytes
from clbvh.geometry.loading.file_mesh import Problems
from clbvh.geometry.loading.texture_files import TextureFiles, decode_image, find_file

TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]
GREY = np.full((2, 3), 128, np.uint8)
UP = np.tile(np.float32([0, 0, 1]), (1, 3, 1))


def make_looks(**changes):
    values = {
        "normals": UP * 5,
        "uvs": [[[0, 0], [1, 0], [0, 1]]],
        "colours": np.array([[[1, 2, 3], [4, 5, 6], [7, 8, 9]]], np.uint8),
        "materials": [clbvh.Material("a"), clbvh.Material("b")],
        "material_ids": [1],
    }
    return clbvh.Appearance(**(values | changes))


def test_values_are_normalised_and_of_the_documented_dtypes():
    looks = make_looks()
    np.testing.assert_array_equal(looks.normals, UP)
    dtypes = [getattr(looks, name).dtype for name in ("normals", "uvs", "colours", "material_ids")]
    assert dtypes == [np.float32, np.float32, np.uint8, np.int32]
    np.testing.assert_array_equal(looks.colours, [[[1, 2, 3, 255], [4, 5, 6, 255], [7, 8, 9, 255]]])
    for length in (1e-300, 1e-30, 1e30, 1e300):
        normals = np.array([[[3, 0, 4], [0, -1, 0], [1, 1, 1]]]) * length
        expected = [[[0.6, 0, 0.8], [0, -1, 0], [3**-0.5] * 3]]
        np.testing.assert_allclose(make_looks(normals=normals).normals, expected, atol=1e-7)


def test_shapes_keep_their_looks():
    looks = make_looks()
    mesh = clbvh.Mesh.from_arrays(*TRIANGLE, appearance=looks)
    assert mesh.fingerprint == clbvh.Mesh.from_arrays(*TRIANGLE).fingerprint
    moved = mesh.with_vertices(mesh.vertices * 2)
    assert moved.appearance.normals is None
    assert moved.appearance.uvs is looks.uvs
    for copied in (pickle.loads(pickle.dumps(mesh)), copy.deepcopy(mesh)):
        np.testing.assert_array_equal(copied.appearance.colours, looks.colours)
        assert copied.appearance.materials == looks.materials
    spheres = clbvh.Spheres([[0, 0, 0], [4, 0, 0]], 1, colours=GREY, materials=looks.materials, material_ids=[1, 0])
    np.testing.assert_array_equal(spheres.appearance.colours, [[128, 128, 128, 255]] * 2)
    assert spheres.with_spheres(spheres.centres + 1).appearance is spheres.appearance
    assert pickle.loads(pickle.dumps(spheres)).appearance.materials == looks.materials
    assert clbvh.Spheres([[0, 0, 0]], 1).appearance is None


@pytest.mark.parametrize("scale", [(1, 1, 4), (-1, 1, 1), (1e-20, 1e-20, 2e-20)])
def test_normals_stay_normal_to_the_faces_and_on_their_side(scale):
    knot = clbvh.make_shape("knot", triangles=500)
    flat = clbvh.smooth_normals_by_angle(knot, 0)
    mesh = clbvh.Mesh.from_arrays(knot.vertices, knot.faces, appearance=clbvh.Appearance(normals=flat))
    moved = clbvh.Transform(scale=scale, rotate=(10, 20, 30)).apply(mesh)
    np.testing.assert_allclose(moved.appearance.normals, clbvh.smooth_normals_by_angle(moved, 0), atol=2e-4)
    flattened = make_looks(normals=[[[0, 0, 1], [1, 0, 0], [0, 1, 0]]]).transformed(np.diag([1.0, 1, 0]))
    np.testing.assert_array_equal(flattened.normals, [[[0, 0, 1]] * 3])


def test_wrong_looks_are_refused():
    two = {"colours": np.zeros((3, 4), np.uint8)}, {"colours": np.zeros((2, 3, 4), np.uint8)}, {"material_ids": [0, 0]}
    spheres = "one of 3 spheres, not of 2", r"shape \(n, 4\)", "material 0, but there are 0"
    rows = [
        (lambda each=each: clbvh.Spheres([[0, 0, 0], [4, 0, 0]], 1, **each), message)
        for each, message in zip(two, spheres, strict=True)
    ]
    looks = clbvh.Appearance(normals=np.tile(UP, (2, 1, 1)))
    rows.append((lambda: clbvh.Mesh.from_arrays(*TRIANGLE, appearance=looks), "one of 2 faces, not of 1"))
    for change, message in (
        ({"normals": UP * 0}, "corner 0 of face 0 has no direction"),
        ({"normals": UP[0]}, r"shape \(F, 3, 3\)"),
        ({"uvs": [[[0, 0], [1e300, 0], [0, 0]]]}, "corner 1 of face 0 are not finite"),
        ({"colours": [[[0.5, 0.5, 0.5]] * 3]}, "uint8"),
        ({"material_ids": [2]}, "face 0 has the material 2"),
        ({"material_ids": [2**40]}, "32 bits"),
    ):
        rows.append((lambda change=change: make_looks(**change), message))
    for values, message in (
        ({"roughness": -0.1}, "roughness must be a number from 0 to 1, not -0.1"),
        ({"base_colour": (1, 1, 2)}, "base_colour must be three finite numbers from 0 to 1"),
        ({"emission": (0, 0, 10**400)}, "emission must be"),
        ({"base_colour_texture": GREY}, "must be a clbvh.Texture, or None, not array"),
    ):
        rows.append((lambda values=values: clbvh.Material(**values), message))
    for pixels, options, message in (
        (GREY.astype(float), {}, "must be uint8"),
        (np.zeros((1, 16_385), np.uint8), {}, "make the picture smaller"),
        (GREY, {"wrap": "tile"}, "two of repeat, clamp, mirror"),
        (GREY, {"filter": None}, "the filter must be linear or nearest, not None"),
    ):
        rows.append((lambda pixels=pixels, options=options: clbvh.Texture("t", pixels, **options), message))
    for make, message in rows:
        with pytest.raises(MeshError, match=message):
            make()


def test_materials_compare_by_value_and_textures_by_identity():
    texture, same = clbvh.Texture("t", GREY), clbvh.Texture("t", GREY)
    assert hash(clbvh.Material(base_colour_texture=texture)) == hash(clbvh.Material(base_colour_texture=texture))
    assert clbvh.Material(base_colour_texture=texture) != clbvh.Material(base_colour_texture=same)
    assert clbvh.Material(base_colour=np.float32([0, 0.5, 1])).base_colour == (0.0, 0.5, 1.0)
    np.testing.assert_array_equal(texture.pixels, np.dstack([GREY] * 3 + [np.full((2, 3), 255)]))
    assert not texture.pixels.flags.writeable
    hole = clbvh.Texture("t", np.zeros((2, 2, 4), np.uint8))
    opaque = [clbvh.Material(base_colour_texture=each).is_opaque for each in (texture, hole)]
    assert [*opaque, clbvh.Material(alpha=0.5).is_opaque] == [True, False, False]


def test_colours_go_to_linear_and_back():
    shares = np.linspace(0, 1, 256)
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(shares)), shares, atol=1e-6)
    np.testing.assert_allclose(srgb_to_linear([0.04045, 0.735357]), [0.0031308, 0.5], atol=1e-6)
    assert to_bytes([-1.0, *shares, 2.0]).tolist() == [0, *range(256), 255]
    with pytest.raises(ValueError, match="not a number"):
        to_bytes([np.nan])


def encode(image, kind="PNG"):
    stream = io.BytesIO()
    image.save(stream, kind)
    return stream.getvalue()


def test_pixels_of_any_picture_become_four_bytes_the_top_row_first():
    grey = np.array([[0, 100, 255], [7, 8, 9]], np.uint8)
    expected = np.dstack([grey] * 3 + [np.full_like(grey, 255)])
    images = [Image.fromarray(grey), Image.fromarray(grey).convert("P"), Image.fromarray(expected)]
    images += [Image.fromarray(expected[..., :3]), Image.fromarray(np.rint(grey * 257.0).astype(np.uint16))]
    contents = [encode(image) for image in images] + [encode(Image.fromarray(grey / np.float32(255)), "TIFF")]
    contents += [encode(images[3], kind) for kind in ("BMP", "TGA", "TIFF")]
    for content in contents:
        np.testing.assert_array_equal(decode_image(content), expected)


def test_pictures_that_claim_to_be_huge_or_would_start_a_program_are_refused():
    for width, height in ((16_385, 1), (1, 2**31 - 1), (60_000, 60_000)):
        content = b"\x89PNG\r\n\x1a\n"
        for chunk in (b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0), b"IDAT"):
            content += struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        with pytest.raises((MeshError, Image.DecompressionBombError), match=r"16,384 on a side|exceeds limit"):
            decode_image(content)
    with pytest.raises(MeshError, match="no picture in a format"):
        decode_image(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n")


def test_textures_are_found_under_the_names_of_other_machines_and_read_once(tmp_path):
    content = encode(Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)))
    (tmp_path / "maps").mkdir()
    for place in ("maps/wood.png", "wood.png"):
        (tmp_path / place).write_bytes(content)
    for name in ("maps/Wood.PNG", "maps\\Wood.PNG", "wood.png", "C:\\old\\wood.png", '"wood.png"', "x/WOOD.png"):
        folder = tmp_path / ("maps" if name.startswith("maps") else "")
        assert find_file(tmp_path, name).samefile(folder / "wood.png"), name
    (tmp_path / "cut.png").write_bytes(content[: len(content) // 2])
    problems = Problems()
    files = TextureFiles(tmp_path, problems)
    texture = files.read("wood.png", is_srgb=True)
    assert files.read("WOOD.png", is_srgb=True) is texture
    assert not files.read("wood.png", is_srgb=False).is_srgb
    assert files.read("b.png", is_srgb=True) is files.read("cut.png", is_srgb=True) is None
    with pytest.warns(UserWarning, match=r"x\.obj: the texture b\.png .*; the texture cut\.png cannot be"):
        problems.warn("x.obj")


def test_normals_in_any_order_of_memory_are_drawn():
    normals = np.moveaxis(np.array([[[0.0, 0, 3]], [[0, 0, 4]], [[1, 1, 0]]]), 0, -1)  # x, y and z each on their own
    for length in (1, 5):
        looks = make_looks(normals=normals / np.linalg.norm(normals, axis=-1, keepdims=True) * length)
        assert looks.normals.flags.c_contiguous
        mesh = clbvh.Mesh.from_arrays(*TRIANGLE, appearance=looks)
        clbvh.render(mesh, width=4, height=4, shading="studio", samples=1)
