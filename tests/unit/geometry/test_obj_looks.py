"""Looks in OBJ files: values of corners, colours of vertices, materials and textures."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from PIL import Image

import clbvh
from clbvh.geometry.appearance.srgb import srgb_to_linear
from clbvh.geometry.loading.load import load_parts

SQUARE = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\n"
NORMALS = "vn 0 0 2\nvn 3 0 4\nvn 0 -1 0\n"
UVS = "vt 0 0\nvt 1 0\nvt 1 0.5\nvt -2 3.5\n"
UNIT = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, -1, 0]])
PAIRS = np.array([[0, 0], [1, 0], [1, 0.5], [-2, 3.5]])


def load(path, text, **files):
    for name, content in files.items():
        (path / name.replace("_", ".")).write_text(content)
    (path / "a.obj").write_text(text)
    return clbvh.load_mesh(path / "a.obj")


def test_each_corner_has_its_own_values_through_the_cut(tmp_path):
    text = SQUARE + NORMALS + UVS + "f 1/4/3 2/3/2 3/2/1 4/1/1\nf 3/1/2 2/2/2 1/3/3\n"
    looks = load(tmp_path, text).appearance
    np.testing.assert_allclose(looks.normals, UNIT[[[2, 1, 0], [2, 0, 0], [1, 1, 2]]], atol=1e-7)
    np.testing.assert_array_equal(looks.uvs, np.float32(PAIRS[[[3, 2, 1], [3, 1, 0], [0, 1, 2]]]))
    assert looks.colours is None
    assert looks.materials == ()


def test_indices_count_back_from_the_lines_above(tmp_path):
    text = (
        SQUARE + "vn 0 0 2\nvt 0 0\nvt 1 0\nf -4/-1/-1 -3/-2/-1 -2/-1/-1\nvn 3 0 4\nvt 1 0.5\nf 1/-1/-1 2/2/-2 3/1/1\n"
    )
    looks = load(tmp_path, text).appearance
    np.testing.assert_allclose(looks.normals, UNIT[[[0, 0, 0], [1, 0, 0]]], atol=1e-7)
    np.testing.assert_array_equal(looks.uvs, np.float32(PAIRS[[[1, 0, 1], [2, 1, 0]]]))


def test_corners_may_lack_values(tmp_path):
    looks = load(tmp_path, SQUARE + NORMALS + UVS + "f 1//2 2 3/2\nf 1/2 3/2 4/2\n").appearance
    np.testing.assert_allclose(looks.normals, [[UNIT[1], UNIT[0], UNIT[0]], [UNIT[0]] * 3], atol=1e-7)
    np.testing.assert_array_equal(looks.uvs, [[[0, 0], [0, 0], [1, 0]], [[1, 0]] * 3])


@pytest.mark.parametrize("weight", ["", " 1.0"], ids=["plain", "weighted"])
def test_colours_stand_behind_the_coordinates(tmp_path, weight):
    shares = np.array([[0, 0.2, 0.4], [0.6, 0.8, 1], [1, 0, 0]])
    lines = [
        f"v {x} {x} {i}{weight} {c[0]} {c[1]} {c[2]}" for i, (x, c) in enumerate(zip([0, 1, 0], shares, strict=True))
    ]
    looks = load(tmp_path, "\n".join([*lines, "f 3 1 2", ""])).appearance
    np.testing.assert_array_equal(looks.colours[0, :, :3], np.rint(shares * 255)[[2, 0, 1]])
    assert looks.materials[0].base_colour == (1.0, 1.0, 1.0)


def test_materials_of_faces(tmp_path):
    mtl = """
    newmtl red paint
    Kd 0.8 0.1 0.2   # sRGB
    Ks 0.5 0.5 0.5
    Ns 98
    newmtl chrome
    Kd 0.5
    Pm 0.9
    Pr 0.25
    Ni 2.5
    newmtl glass
    illum 7
    Kd 0 0 0
    Tf 0.9 1 0.9
    Ni 1.33
    d 0.1
    newmtl lamp
    Ke 5 6 7
    newmtl thin
    Kd 0 0 0
    d 0.25
    newmtl thin too
    Ks 0 0 0
    Tr 0.75
    newmtl solid
    d 0
    """
    names = ["chrome", "red paint", "glass", "lamp", "thin", "thin too", "solid"]
    faces = "f 1 2 3\n" + "".join(f"usemtl {name}\nf 1 2 3 4\n" for name in [*names, "chrome"])
    looks = load(tmp_path, "mtllib some colours.mtl\n" + SQUARE + faces, **{"some colours_mtl": mtl}).appearance
    assert looks.material_ids.tolist() == [7, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 0, 0]
    chrome, red, glass, lamp, thin, thin_too, solid, none = looks.materials
    assert red.base_colour == pytest.approx(srgb_to_linear([0.8, 0.1, 0.2]))
    assert (red.name, red.metallic, red.roughness) == ("red paint", 0, pytest.approx(0.02**0.25))
    assert (chrome.metallic, chrome.roughness, chrome.ior) == (0.9, 0.25, 2.5)
    assert (glass.base_colour, glass.transmission, glass.ior, glass.alpha) == ((0.9, 1.0, 0.9), 1, 1.33, 1)
    assert lamp.emission == (5, 6, 7)
    assert (thin.alpha, thin_too.alpha, solid.alpha) == (0.25, 0.25, 1)
    assert thin_too.roughness == 1  # no highlight
    assert none == clbvh.Material()


def test_textures_of_colour_alpha_and_light(tmp_path):
    pixels = np.arange(2 * 4 * 3, dtype=np.uint8).reshape(2, 4, 3)
    mask = np.array([[0, 255]], np.uint8)
    (tmp_path / "maps").mkdir()
    Image.fromarray(pixels).save(tmp_path / "maps" / "my wood.png")
    Image.fromarray(mask).save(tmp_path / "mask.png")
    mtl = r"""
    newmtl a
    map_Kd -s 1 1 1 -clamp on maps\my wood.png
    map_d C:\Users\someone\mask.png
    map_Ke maps/my wood.png
    newmtl b
    Kd 0.5 0.5 0.5
    map_d mask.png
    """
    text = "mtllib a.mtl\n" + SQUARE + UVS + "usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 1/1 3/3 4/4\n"
    one, two = load(tmp_path, text, a_mtl=mtl).appearance.materials
    expected = np.dstack((pixels, np.repeat([[0, 0, 255, 255]], 2, axis=0)))
    np.testing.assert_array_equal(one.base_colour_texture.pixels, expected)
    assert one.base_colour_texture.wrap == ("clamp", "clamp")
    np.testing.assert_array_equal(one.emission_texture.pixels[..., :3], pixels)
    assert one.emission == (1, 1, 1)
    np.testing.assert_array_equal(two.base_colour_texture.pixels, [[[255, 255, 255, 0], [255, 255, 255, 255]]])


def test_normals_of_a_texture_are_read_and_heights_are_not(tmp_path):
    Image.fromarray(np.full((1, 2, 3), (128, 128, 255), np.uint8)).save(tmp_path / "bent normals.png")
    mtl = "newmtl a\nnorm bent normals.png\nnewmtl b\nmap_Bump -bm 0.3 lost.png\nnewmtl c\nbump lost.png\n"
    text = "mtllib a.mtl\n" + SQUARE + UVS + "usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 1/1 3/3 4/4\n"
    with pytest.warns(clbvh.AppearanceWarning, match=r"the heights of map_Bump in .*a\.mtl are not drawn") as caught:
        one, two = load(tmp_path, text, a_mtl=mtl).appearance.materials
    assert len(caught) == 1
    assert str(caught[0].message).count("map_Bump") == 1
    assert (one.normal_texture.pixels == (128, 128, 255, 255)).all()
    assert not one.normal_texture.is_srgb
    assert two.normal_texture is None


def test_a_mask_may_be_larger_than_the_colours(tmp_path):
    Image.fromarray(np.array([[[9, 8, 7]], [[1, 2, 3]]], np.uint8)).save(tmp_path / "a.png")
    Image.fromarray(np.array([[0, 50], [100, 150]], np.uint8)).save(tmp_path / "m.png")
    text = "mtllib a.mtl\nusemtl a\n" + SQUARE + "f 1 2 3\n"
    (material,) = load(tmp_path, text, a_mtl="newmtl a\nKd 0 0 0\nmap_Kd a.png\nmap_d m.png\n").appearance.materials
    expected = [[[9, 8, 7, 0], [9, 8, 7, 50]], [[1, 2, 3, 100], [1, 2, 3, 150]]]
    assert material.base_colour_texture.pixels.tolist() == expected


def test_an_alpha_that_no_statement_asks_for_is_ignored(tmp_path):
    Image.fromarray(np.full((1, 1, 4), 9, np.uint8)).save(tmp_path / "a.png")
    text = "mtllib a.mtl\nusemtl a\n" + SQUARE + "f 1 2 3\n"
    (material,) = load(tmp_path, text, a_mtl="newmtl a\nKd 0 0 0\nmap_Kd a.png\n").appearance.materials
    assert material.base_colour_texture.pixels.tolist() == [[[9, 9, 9, 255]]]
    assert material.base_colour == (1, 1, 1)
    assert material.is_opaque


@pytest.mark.parametrize(
    ("text", "mtl", "message"),
    [
        ("mtllib lost.mtl\nusemtl a\n", "", "the materials .*lost.mtl is missing"),
        ("mtllib ..\nusemtl a\n", "", "cannot be read: this is a folder"),
        ("mtllib /dev/zero\nusemtl a\n", "", "cannot be read: this is a device"),
        ("mtllib a.mtl\nusemtl b\nf 1 2 3\nusemtl a\n", "newmtl a\nKd 0 0 0\n", "materials 'b' are missing"),
        ("mtllib a.mtl\nusemtl a\n", "newmtl a\nKd 1 2\nKe x\n", "material 'a' cannot be used"),
        ("mtllib a.mtl\nusemtl a\n", "newmtl a\nKd nan 0 0\n", "material 'a' cannot be used"),
        ("mtllib a.mtl\nusemtl a\n", "newmtl a\nmap_Kd lost.png\nmap_Ke lost.png\n", "texture .*lost.png is missing"),
        ("mtllib a.mtl\nusemtl a\n", "newmtl a\nmap_Kd a.mtl\n", "no picture in a format that is read"),
        ("vt 0 0\nvt 1 1\nvt nan 0\nf 1/1 2/2 3/3\n", "", "texture coordinates .*cannot be used"),
        ("vn 0 0 1\nf 1//1 2//1 3//2\n", "", "normals cannot be used: a corner refers to one that is not among the 1"),
        ("vn 0 0 x\nf 1//1 2//1 3//1\n", "", "normals cannot be used"),
        ("f 1//1 2//1 3//1\n", "", "normals cannot be used"),
        ("f 1/1/1/1 2 3\n", "", "a corner has words that are no indices"),
        ("vn 0 0 1\nf 1//x 2//1 3//1\n", "", "a corner has words that are no indices"),
    ],
)
def test_what_cannot_be_used_is_one_warning(tmp_path, text, mtl, message):
    with pytest.warns(clbvh.AppearanceWarning, match=message) as caught:
        mesh = load(tmp_path, SQUARE + text + "f 1 2 3\n", a_mtl=mtl)
    assert len(caught) == 1
    assert mesh.faces[-1].tolist() == [0, 1, 2]


def test_many_problems_are_one_warning_that_counts_the_rest(tmp_path):
    text = SQUARE + "mtllib a.mtl\nvn 0 0 x\n" + "".join(f"usemtl {i}\nf 1//1 2//1 3//1\n" for i in range(6))
    mtl = "".join(f"newmtl {i}\nKd x\n" for i in range(5)) + "newmtl 5\n"
    with pytest.warns(clbvh.AppearanceWarning, match=r"normals .*; the material '0' .*; and 4 more$") as caught:
        load(tmp_path, text, a_mtl=mtl)
    assert len(caught) == 1


def test_materials_without_a_file_are_names_and_no_fault(tmp_path):
    assert load(tmp_path, SQUARE + "usemtl stone\nf 1 2 3\n").appearance is None


def test_faces_that_smoothing_leaves_out_are_flat(tmp_path):
    fold = "v 0 0 0\nv 1 0 0\nv 0 1 0.1\nv 0 -1 0.1\n"
    faces = "f 1 2 3\nf 1 4 2\n"
    flat = load(tmp_path, f"{fold}s off\n{faces}").appearance.normals
    mesh = load(tmp_path, fold + faces)
    assert mesh.appearance is None
    np.testing.assert_allclose(flat, clbvh.smooth_normals_by_angle(mesh, 0), atol=1e-6)
    mixed = load(tmp_path, f"{fold}s 1\nf 1 2 3\ns 0\nf 1 4 2\n").appearance.normals
    np.testing.assert_allclose(mixed[0], clbvh.smooth_normals_by_angle(mesh, 40)[0], atol=1e-6)
    np.testing.assert_allclose(mixed[1], flat[1], atol=1e-6)


def test_parts_keep_the_looks_of_their_faces(tmp_path):
    text = SQUARE + UVS + "o a\nusemtl red\nf 1/1 2/2 3/3\no b\nusemtl blue\nf 1/4 3/3 4/2\no a\nf 2/2 3/3 4/4\n"
    mtl = "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n"
    load(tmp_path, "mtllib a.mtl\n" + text, a_mtl=mtl)
    first, second = load_parts(tmp_path / "a.obj").meshes
    np.testing.assert_array_equal(first.appearance.uvs, np.float32(PAIRS[[[0, 1, 2], [1, 2, 3]]]))
    np.testing.assert_array_equal(second.appearance.uvs, np.float32(PAIRS[[[3, 2, 1]]]))
    assert [one.appearance.material_ids.tolist() for one in (first, second)] == [[0, 1], [1]]


@pytest.mark.parametrize("seed", [0])
def test_what_trimesh_writes_is_read(tmp_path, seed):
    ball = trimesh.creation.icosphere(subdivisions=2)
    generator = np.random.default_rng(seed)
    uvs = generator.random((len(ball.vertices), 2))
    image = Image.fromarray(generator.integers(0, 256, (4, 8, 3), np.uint8))
    material = trimesh.visual.material.SimpleMaterial(image=image, diffuse=[255, 255, 255, 255])
    ball.visual = trimesh.visual.TextureVisuals(uv=uvs, material=material)
    ball.export(tmp_path / "a.obj", include_normals=True)
    mesh = clbvh.load_mesh(tmp_path / "a.obj")
    np.testing.assert_allclose(mesh.appearance.uvs, uvs[ball.faces], atol=1e-6)
    np.testing.assert_allclose(mesh.appearance.normals, ball.vertex_normals[ball.faces], atol=1e-5)
    (read,) = mesh.appearance.materials
    np.testing.assert_array_equal(read.base_colour_texture.pixels[..., :3], np.asarray(image))
    assert read.base_colour == (1, 1, 1)
