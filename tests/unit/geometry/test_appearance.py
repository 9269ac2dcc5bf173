"""Appearances, materials and textures: checked when they are made, and kept by shapes."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import clbvh
from clbvh.geometry.appearance.srgb import linear_to_srgb, srgb_to_linear, to_bytes

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
    assert [looks.normals.dtype, looks.uvs.dtype, looks.colours.dtype, looks.material_ids.dtype] == [
        np.float32,
        np.float32,
        np.uint8,
        np.int32,
    ]
    np.testing.assert_array_equal(looks.colours, [[[1, 2, 3, 255], [4, 5, 6, 255], [7, 8, 9, 255]]])
    assert isinstance(looks.materials, tuple)
    assert looks.prim_count == 1
    assert clbvh.Appearance().is_empty
    assert not make_looks().is_empty


@pytest.mark.parametrize("length", [1e-300, 1e-30, 1e30, 1e300])
def test_normals_of_any_length_have_a_direction(length):
    normals = np.array([[[3, 0, 4], [0, -1, 0], [1, 1, 1]]]) * length
    expected = [[[0.6, 0, 0.8], [0, -1, 0], [3**-0.5] * 3]]
    np.testing.assert_allclose(clbvh.Appearance(normals=normals).normals, expected, atol=1e-7)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"normals": UP * 0}, "corner 0 of face 0 has no direction"),
        ({"normals": UP * np.nan}, "has no direction"),
        ({"normals": [[[0, 0, np.inf]] * 3]}, "has no direction"),
        ({"normals": UP[0]}, r"shape \(F, 3, 3\)"),
        ({"normals": [[["x"] * 3] * 3]}, "must be numbers"),
        ({"uvs": UP}, r"shape \(F, 3, 2\)"),
        ({"uvs": [[[0, 0], [np.nan, 0], [0, 0]]]}, "corner 1 of face 0 are not finite"),
        ({"uvs": [[[0, 0], [1e300, 0], [0, 0]]]}, "corner 1 of face 0 are not finite"),
        ({"colours": [[[0.5, 0.5, 0.5]] * 3]}, "uint8"),
        ({"colours": np.zeros((1, 3, 5), np.uint8)}, r"\(F, 3, 4\)"),
        ({"colours": np.zeros((2, 3, 4), np.uint8)}, "colours of 2"),
        ({"material_ids": [2]}, "face 0 has the material 2"),
        ({"material_ids": [-1]}, "face 0 has the material -1"),
        ({"material_ids": [2**40]}, "32 bits"),
        ({"material_ids": [0.0]}, "integers"),
        ({"materials": ["red"]}, "clbvh.Material"),
        ({"materials": 5}, "clbvh.Material"),
    ],
)
def test_wrong_values_are_refused(changes, message):
    with pytest.raises(clbvh.MeshError, match=message):
        make_looks(**changes)


def test_a_mesh_refuses_looks_of_another_number_of_faces_or_of_spheres():
    with pytest.raises(clbvh.MeshError, match="one of 2 faces, not of 1"):
        clbvh.Mesh.from_arrays(*TRIANGLE, appearance=clbvh.Appearance(normals=np.tile(UP, (2, 1, 1))))
    with pytest.raises(clbvh.MeshError, match=r"shape \(F, 3, 4\)"):
        clbvh.Mesh.from_arrays(*TRIANGLE, appearance=clbvh.Appearance(colours=GREY[:1]))
    with pytest.raises(clbvh.MeshError, match=r"a clbvh\.Appearance"):
        clbvh.Mesh.from_arrays(*TRIANGLE, appearance=clbvh.Material())


def test_a_mesh_keeps_its_looks():
    looks = make_looks()
    mesh = clbvh.Mesh.from_arrays(*TRIANGLE, appearance=looks)
    assert mesh.appearance is looks
    assert mesh.fingerprint == clbvh.Mesh.from_arrays(*TRIANGLE).fingerprint
    assert dataclasses.replace(mesh, name="other").appearance is looks
    moved = mesh.with_vertices(mesh.vertices * 2)
    assert moved.appearance.normals is None
    assert moved.appearance.uvs is looks.uvs or (moved.appearance.uvs == looks.uvs).all()
    assert clbvh.Mesh.from_arrays(*TRIANGLE).with_vertices(mesh.vertices).appearance is None
    for copied in (pickle.loads(pickle.dumps(mesh)), copy.deepcopy(mesh)):
        np.testing.assert_array_equal(copied.appearance.colours, looks.colours)
        assert copied.appearance.materials == looks.materials


@pytest.mark.parametrize("scale", [2.0, (1, 1, 4), (-1, 1, 1), (1e-20, 1e-20, 2e-20)])
def test_normals_stay_normal_to_the_faces_and_on_their_side(scale):
    knot = clbvh.make_shape("knot", triangles=500)
    flat = clbvh.smooth_normals_by_angle(knot, 0)
    mesh = clbvh.Mesh.from_arrays(knot.vertices, knot.faces, appearance=clbvh.Appearance(normals=flat))
    moved = clbvh.Transform(scale=scale, rotate=(10, 20, 30)).apply(mesh)
    np.testing.assert_allclose(moved.appearance.normals, clbvh.smooth_normals_by_angle(moved, 0), atol=2e-4)


def test_a_matrix_that_flattens_leaves_unit_normals():
    turned = make_looks(normals=[[[0, 0, 1], [1, 0, 0], [0, 1, 0]]]).transformed(np.diag([1.0, 1, 0]))
    np.testing.assert_array_equal(turned.normals, [[[0, 0, 1]] * 3])
    assert make_looks().transformed(np.zeros((3, 3))).normals is not None


def test_faces_are_selected_with_all_their_values():
    looks = clbvh.Appearance(
        normals=np.tile(UP, (4, 1, 1)),
        colours=np.arange(48, dtype=np.uint8).reshape(4, 3, 4),
        materials=[clbvh.Material()],
        material_ids=np.zeros(4, int),
    )
    chosen = looks.select(np.array([3, 1]))
    np.testing.assert_array_equal(chosen.colours, looks.colours[[3, 1]])
    assert len(chosen.normals) == len(chosen.material_ids) == 2
    assert chosen.uvs is None


def test_spheres_have_colours_and_materials_that_movement_keeps():
    looks = {"colours": GREY, "materials": [clbvh.Material("a"), clbvh.Material("b")], "material_ids": [1, 0]}
    spheres = clbvh.Spheres([[0, 0, 0], [4, 0, 0]], 1, **looks)
    np.testing.assert_array_equal(spheres.appearance.colours, [[128, 128, 128, 255]] * 2)
    np.testing.assert_array_equal(spheres.appearance.material_ids, [1, 0])
    assert spheres.with_spheres(spheres.centres + 1).appearance is spheres.appearance
    assert clbvh.Spheres.from_arrays([[0, 0, 0]], 1, materials=looks["materials"]).appearance.materials[1].name == "b"
    assert clbvh.Spheres([[0, 0, 0]], 1).appearance is None
    assert pickle.loads(pickle.dumps(spheres)).appearance.materials == spheres.appearance.materials


@pytest.mark.parametrize(
    ("looks", "message"),
    [
        ({"colours": np.zeros((3, 4), np.uint8)}, "one of 3 spheres, not of 2"),
        ({"colours": np.zeros((2, 3, 4), np.uint8)}, r"shape \(n, 4\)"),
        ({"material_ids": [0, 0]}, "material 0, but there are 0"),
    ],
)
def test_spheres_refuse_other_looks(looks, message):
    with pytest.raises(clbvh.MeshError, match=message):
        clbvh.Spheres([[0, 0, 0], [4, 0, 0]], 1, **looks)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"roughness": -0.1}, "roughness must be a number from 0 to 1, not -0.1"),
        ({"metallic": np.nan}, "metallic must be"),
        ({"alpha": "1"}, "alpha must be"),
        ({"alpha_cutoff": -1}, "alpha_cutoff must be a number of at least 0"),
        ({"normal_scale": 101}, "normal_scale must be a number from -100 to 100"),
        ({"ior": 0.9}, "ior must be a number from 1 to 100"),
        ({"transmission": True}, "transmission must be"),
        ({"base_colour": (1, 1)}, "base_colour must be three numbers from 0 to 1"),
        ({"base_colour": (1, 1, 2)}, "base_colour must be"),
        ({"base_colour": "red"}, "base_colour must be"),
        ({"emission": (0, 0, np.inf)}, "emission must be"),
        ({"emission": (0, 0, 10**400)}, "emission must be"),
        ({"name": 5}, "name must be a text"),
        ({"base_colour_texture": GREY}, "must be a clbvh.Texture, not a ndarray"),
    ],
)
def test_wrong_materials_are_refused(values, message):
    with pytest.raises(clbvh.MeshError, match=message):
        clbvh.Material(**values)


def test_materials_compare_by_value_and_textures_by_identity():
    texture, same = clbvh.Texture("t", GREY), clbvh.Texture("t", GREY)
    assert hash(clbvh.Material(base_colour_texture=texture)) == hash(clbvh.Material(base_colour_texture=texture))
    assert clbvh.Material(base_colour_texture=texture) != clbvh.Material(base_colour_texture=same)
    material = clbvh.Material(base_colour=np.float32([0, 0.5, 1]), emission=[0, 0, 20])
    assert material.base_colour == (0.0, 0.5, 1.0)
    assert repr(material) == "Material(base_colour=(0.0, 0.5, 1.0), emission=(0.0, 0.0, 20.0))"
    assert clbvh.Material(emission_texture=texture, base_colour_texture=same).textures == (same, texture)


def test_opaque_is_what_neither_number_nor_texture_thins():
    hole = np.full((2, 2, 4), 255, np.uint8)
    hole[0, 0, 3] = 0
    assert clbvh.Material(base_colour_texture=clbvh.Texture("t", GREY)).is_opaque
    assert not clbvh.Material(base_colour_texture=clbvh.Texture("t", hole)).is_opaque
    assert not clbvh.Material(alpha=0.5).is_opaque


def test_pixels_become_four_bytes_that_nobody_changes():
    grey = clbvh.Texture("grey", GREY)
    np.testing.assert_array_equal(grey.pixels, np.dstack([GREY] * 3 + [np.full((2, 3), 255)]))
    assert (grey.width, grey.height, grey.is_srgb, grey.wrap) == (3, 2, True, ("repeat", "repeat"))
    with pytest.raises(ValueError, match="read-only"):
        grey.pixels[0] = 0


@pytest.mark.parametrize(
    ("pixels", "wrap", "message"),
    [
        (GREY.astype(float), "repeat", "must be uint8"),
        (GREY[0], "repeat", r"shape \(h, w, 4\)"),
        (GREY[:0], "repeat", r"shape \(h, w, 4\)"),
        (np.zeros((1, 16_385), np.uint8), "repeat", "make the picture smaller"),
        (GREY, "tile", "two of repeat, clamp, mirror"),
        (GREY, ("repeat",), "two of repeat"),
    ],
)
def test_wrong_textures_are_refused(pixels, wrap, message):
    with pytest.raises(clbvh.MeshError, match=message):
        clbvh.Texture("t", pixels, wrap=wrap)


def test_colours_go_to_linear_and_back():
    shares = np.linspace(0, 1, 256)
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(shares)), shares, atol=1e-6)
    np.testing.assert_allclose(srgb_to_linear([0.04045, 0.735357]), [0.0031308, 0.5], atol=1e-6)
    assert to_bytes(shares).tolist() == list(range(256))
    assert to_bytes([-1.0, 2.0]).tolist() == [0, 255]
    with pytest.raises(ValueError, match="not a number"):
        to_bytes([np.nan])
