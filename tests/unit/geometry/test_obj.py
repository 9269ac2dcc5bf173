"""OBJ files: the order of faces, parts, values of corners, materials and textures."""

import numpy as np
import pytest
from PIL import Image

import clbvh
from clbvh import AppearanceWarning
from clbvh.geometry.appearance.srgb import srgb_to_linear

SQUARE = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\n"
NORMALS = "vn 0 0 2\nvn 3 0 4\nvn 0 -1 0\n"
UVS = "vt 0 0\nvt 1 0\nvt 1 0.5\nvt -2 3.5\n"
UNIT = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, -1, 0]])
PAIRS = np.float32([[0, 0], [1, 0], [1, 0.5], [-2, 3.5]])


@pytest.fixture
def load(tmp_path):
    def load_text(text, mtl=""):
        (tmp_path / "a.mtl").write_text(mtl)
        (tmp_path / "a.obj").write_text(text)
        return clbvh.load_mesh(tmp_path / "a.obj")

    return load_text


def test_objects_and_materials_keep_the_order(load):
    text = """
    # made by hand
    o first
    v 0 0 0
    v 1 0 0 0.5 0.5 0.5
      v 1 1 0 1.0
    usemtl red
    f 1/1/1 2/1/1 3/1/1
    v 0 1 0
    vt 0 0
    vn 0 0 1
    g second
    f -4//1 -2//1 -1//1   # counted back
    o third
    v 0 0 1
    f 1 2 \\
      3 4
    f\t5 4 3
    l 1 2
    """
    mesh = load(text)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [4, 3, 2]]
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]]
    assert mesh.parts == (("first", 0, 2), ("third", 2, 5))


@pytest.mark.filterwarnings("ignore::clbvh.AppearanceWarning")
def test_parts_are_objects_or_else_groups(load):
    for text, parts in (
        ("o one\nf 1 2 3\no other\nf 1 2 3 4", [("one", 0, 1), ("other", 1, 3)]),
        ("f 1 2 3\ng  x   y \nf 1 2 3", [("a", 0, 1), ("x y", 1, 2)]),
        ("g x\nf 1 2 3\ng y\nf 1 2 3\ng x\nf 1 2 4", [("x", 0, 1), ("y", 1, 2), ("x", 2, 3)]),
        ("o one\ng x\nf 1 2 3\ng y\nf 1 2 3\no other\nf 1 2 3", [("one", 0, 2), ("other", 2, 3)]),
        ("o one\nf 1 2\nf 1 2 3\no line\nf 1 2\no other\nf 1 2 3", [("one", 0, 1), ("other", 1, 2)]),
    ):
        assert list(load(SQUARE + text + "\n").parts) == parts


def test_each_corner_has_its_own_values(load):
    looks = load(SQUARE + NORMALS + UVS + "f 1/4/3 2/3/2 3/2/1 4/1/1\nf 3/1/2 2/2/2 1/3/3\n").appearance
    np.testing.assert_allclose(looks.normals, UNIT[[[2, 1, 0], [2, 0, 0], [1, 1, 2]]], atol=1e-7)
    np.testing.assert_array_equal(looks.uvs, PAIRS[[[3, 2, 1], [3, 1, 0], [0, 1, 2]]])
    assert (looks.colours, looks.materials) == (None, ())
    # Counted back from the lines above.
    text = "vn 0 0 2\nvt 0 0\nvt 1 0\nf -4/-1/-1 -3/-2/-1 -2/-1/-1\nvn 3 0 4\nvt 1 0.5\nf 1/-1/-1 2/2/-2 3/1/1\n"
    looks = load(SQUARE + text).appearance
    np.testing.assert_allclose(looks.normals, UNIT[[[0, 0, 0], [1, 0, 0]]], atol=1e-7)
    np.testing.assert_array_equal(looks.uvs, PAIRS[[[1, 0, 1], [2, 1, 0]]])
    looks = load(SQUARE + NORMALS + UVS + "f 1//2 2 3/2\n").appearance  # corners may lack values
    np.testing.assert_allclose(looks.normals, [[UNIT[1], UNIT[0], UNIT[0]]], atol=1e-7)
    np.testing.assert_array_equal(looks.uvs, [[[0, 0], [0, 0], [1, 0]]])


def test_colours_stand_behind_the_coordinates(load):
    for weight in ("", " 1.0"):
        text = f"v 0 0 0{weight} 0 0.2 0.4\nv 1 1 1{weight} 0.6 0.8 1\nv 0 0 2{weight} 1 0 0\nf 3 1 2\n"
        looks = load(text).appearance
        assert looks.colours[0, :, :3].tolist() == [[255, 0, 0], [0, 51, 102], [153, 204, 255]]
        assert looks.materials[0].base_colour == (1.0, 1.0, 1.0)


def test_materials_of_faces(load, tmp_path):
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
    (tmp_path / "some colours.mtl").write_text(mtl)
    names = ["chrome", "red paint", "glass", "lamp", "thin", "thin too", "solid", "chrome"]
    faces = "f 1 2 3\n" + "".join(f"usemtl {name}\nf 1 2 3 4\n" for name in names)
    looks = load("mtllib some colours.mtl\n" + SQUARE + faces).appearance
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
    assert load(SQUARE + "usemtl stone\nf 1 2 3\n").appearance is None


def test_textures_of_colour_alpha_light_and_normals(load, tmp_path):
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    (tmp_path / "maps").mkdir()
    Image.fromarray(pixels).save(tmp_path / "maps" / "my wood.png")
    Image.fromarray(np.array([[0, 255]], np.uint8)).save(tmp_path / "mask.png")
    Image.fromarray(np.full((1, 1, 4), 9, np.uint8)).save(tmp_path / "thin.png")
    mtl = r"""
    newmtl a
    map_Kd -s 1 1 1 -clamp on maps\my wood.png
    map_d C:\Users\someone\mask.png
    map_Ke maps/my wood.png
    norm maps/my wood.png
    newmtl b
    Kd 0.5 0.5 0.5
    map_d mask.png
    newmtl c
    Kd 0 0 0
    map_Kd thin.png
    """
    text = "mtllib a.mtl\n" + SQUARE + "usemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\nusemtl c\nf 1 2 3\n"
    one, two, three = load(text, mtl).appearance.materials
    expected = np.dstack((pixels, np.repeat([[0, 0, 255, 255]], 2, axis=0)))
    np.testing.assert_array_equal(one.base_colour_texture.pixels, expected)
    assert one.base_colour_texture.wrap == ("clamp", "clamp")
    np.testing.assert_array_equal(one.emission_texture.pixels[..., :3], pixels)
    assert one.emission == (1, 1, 1)
    assert (one.base_colour_texture.is_srgb, one.normal_texture.is_srgb) == (True, False)
    np.testing.assert_array_equal(two.base_colour_texture.pixels, [[[255, 255, 255, 0], [255, 255, 255, 255]]])
    # An alpha that no statement asks for is ignored, and so is black beside a texture.
    assert three.base_colour_texture.pixels.tolist() == [[[9, 9, 9, 255]]]
    assert three.base_colour == (1, 1, 1)
    assert three.is_opaque


def test_options_of_textures_place_and_clamp_them(load, tmp_path):
    for name in ("a.png", "2 wood.png", "e dark wood.png"):
        Image.fromarray(np.full((1, 1, 3), len(name), np.uint8)).save(tmp_path / name)
    text = "mtllib a.mtl\n" + SQUARE + UVS + "f 1/1 2/2 3/3\nusemtl a\nf 1/1 2/2 3/3 4/4\nusemtl b\nf 1/1 2/2 3/3\n"
    for statement, scale, offset, wrap, name in (
        ("map_Kd -s 2 3 1 -o 0.5 0 a.png", (2, 3), (0.5, 0), "repeat", "a.png"),
        ("map_Ke -o -.5 1e-1 0 -clamp on -s 2. a.png", (2, 1), (-0.5, 0.1), "clamp", "a.png"),
        ("map_Kd\t-clamp  off\t-O\t+4   -bm 1.0 2 wood.png", (1, 1), (4, 0), "repeat", "2 wood.png"),
        ("map_d -s 1 1 1 e dark wood.png", (1, 1), (0, 0), "repeat", "e dark wood.png"),
        ("norm -bm 0.25 -s 1 2 3 2 wood.png", (1, 2), (0, 0), "repeat", "2 wood.png"),
        ("map_Kd -mm 0 1 -blendu on -boost 0.000 -t 0 0 0 -imfchan l a.png", (1, 1), (0, 0), "repeat", "a.png"),
    ):
        looks = load(text, f"newmtl a\n{statement}\nnewmtl b\nKd 1 1 1\n").appearance
        placed = PAIRS * scale + offset
        expected = [PAIRS[[0, 1, 2]], placed[[0, 1, 2]], placed[[0, 2, 3]], PAIRS[[0, 1, 2]]]
        np.testing.assert_allclose(looks.uvs, expected, atol=1e-6)
        (texture,) = looks.materials[0].textures
        assert (texture.name, texture.wrap) == (name, (wrap, wrap))
        assert looks.materials[0].normal_scale == (0.25 if "norm" in statement else 1)


def test_what_cannot_be_used_is_one_warning(load, tmp_path):
    Image.fromarray(np.zeros((1, 1, 3), np.uint8)).save(tmp_path / "x.png")
    use = "mtllib a.mtl\nusemtl a\n"
    many = "mtllib a.mtl\nvn 0 0 x\n" + "".join(f"usemtl {i}\nf 1//1 2//1 3//1\n" for i in range(6))
    for text, mtl, message in (
        ("mtllib lost.mtl\nusemtl a\n", "", "the materials .*lost.mtl is missing"),
        ("mtllib /dev/zero\nusemtl a\n", "", "cannot be read: this is a device"),
        ("mtllib a.mtl\nusemtl b\nf 1 2 3\nusemtl a\n", "newmtl a\nKd 0 0 0\n", "materials 'b' are missing"),
        (use, "newmtl a\nKd 1 2\nKe x\n", "material 'a' cannot be used"),
        (use, "newmtl a\nmap_Kd lost.png\nmap_Ke lost.png\n", "texture .*lost.png is missing"),
        (use, "newmtl a\nmap_Bump -bm 0.3 x.png\nnewmtl b\nbump x.png\n", r"heights of map_Bump in .*a\.mtl are not"),
        (use, "newmtl a\nmap_Kd -mm 0.1 0.9 x.png\n", r"^[^;]*the option -mm of map_kd in .*a\.mtl is not used$"),
        (use, "newmtl a\nmap_d -bm 2 -blendu off -s 2 x.png\n", r"-bm of map_d .*; the option -blendu of map_d "),
        (use, "newmtl a\nmap_Kd -s 2 x.png\nmap_Ke x.png\n", "the textures of 'a' lie differently: all are placed as"),
        (use, "newmtl a\nmap_Kd -s 1e999 x.png\n", "material 'a' cannot be used: an option of map_kd is more than"),
        ("vt 0 0\nvt 1 1\nvt nan 0\nf 1/1 2/2 3/3\n", "", "texture coordinates .*cannot be used"),
        ("vn 0 0 1\nf 1//1 2//1 3//2\n", "", "normals cannot be used: a corner refers to one that is not among the 1"),
        ("vn 0 0 1\nf 1//1 2//1 3//-2\n", "", "normals cannot be used: a corner refers to one that is not among the 1"),
        ("f 1/1/1/1 2 3\n", "", "a corner has words that are no indices"),
        (many, "".join(f"newmtl {i}\nKd x\n" for i in range(6)), r"normals .*; the material '0' .*; and 4 more$"),
    ):
        with pytest.warns(AppearanceWarning, match=message) as caught:
            mesh = load(SQUARE + text + "f 1 2 3\n", mtl)
        assert len(caught) == 1
        assert str(caught[0].message).count("map_Bump") <= 1
        assert mesh.faces[-1].tolist() == [0, 1, 2]


def test_faces_that_smoothing_leaves_out_are_flat(load):
    fold, faces = "v 0 0 0\nv 1 0 0\nv 0 1 0.1\nv 0 -1 0.1\n", "f 1 2 3\nf 1 4 2\n"
    mesh = load(fold + faces)
    assert mesh.appearance is None
    flat, smooth = clbvh.smooth_normals_by_angle(mesh, 0), clbvh.smooth_normals_by_angle(mesh, 40)
    np.testing.assert_allclose(load(f"{fold}s off\n{faces}").appearance.normals, flat, atol=1e-6)
    mixed = load(f"{fold}s 1\nf 1 2 3\ns 0\nf 1 4 2\n").appearance.normals
    np.testing.assert_allclose(mixed, [smooth[0], flat[1]], atol=1e-6)


def test_parts_keep_the_looks_of_their_faces(load, tmp_path):
    text = SQUARE + UVS + "o a\nusemtl red\nf 1/1 2/2 3/3\no b\nusemtl blue\nf 1/4 3/3 4/2\no a\nf 2/2 3/3 4/4\n"
    load("mtllib a.mtl\n" + text, "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    scene = clbvh.Scene()
    scene.add_parts(tmp_path / "a.obj")
    first, second = (geometry.shape.appearance for geometry in scene.geometries)
    np.testing.assert_array_equal(first.uvs, PAIRS[[[0, 1, 2], [1, 2, 3]]])
    np.testing.assert_array_equal(second.uvs, PAIRS[[[3, 2, 1]]])
    assert [looks.material_ids.tolist() for looks in (first, second)] == [[0, 1], [0]]
    assert [[each.name for each in looks.materials] for looks in (first, second)] == [["red", "blue"], ["blue"]]
