"""Appearances in saved scenes: they come back, and forged ones are refused."""

import dataclasses

import numpy as np
import pytest

import clbvh
from clbvh.errors import SceneError

from .test_serialize import forge, split

TEXTURE = clbvh.Texture(
    "checker", np.arange(24, dtype=np.uint8).reshape(3, 2, 4), is_srgb=False, wrap=("clamp", "mirror")
)
PLAIN = clbvh.Texture("plain", np.full((1, 5), 7, np.uint8))
MATERIALS = (
    clbvh.Material("tiles", base_colour=(0.1, 0.2, 0.3), base_colour_texture=TEXTURE, alpha_cutoff=0.5),
    clbvh.Material(
        "lamp",
        emission=(5, 6, 7),
        emission_texture=TEXTURE,
        transmission=1,
        ior=1.33,
        alpha_cutoff=np.inf,
        metallic_roughness_texture=PLAIN,
    ),
)
MESH = clbvh.Mesh.from_arrays(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
    [[0, 1, 2], [2, 1, 0], [1, 2, 0]],
    appearance=clbvh.Appearance(
        normals=np.tile(np.float32([0.6, 0, 0.8]), (3, 3, 1)),
        uvs=np.arange(18).reshape(3, 3, 2),
        colours=np.arange(36, dtype=np.uint8).reshape(3, 3, 4),
        materials=MATERIALS,
        material_ids=[0, 1, 0],
    ),
    parts=[("front", 0, 1), ("back", 1, 3)],
)
DOTS = clbvh.Spheres(np.eye(3), 0.1, colours=np.arange(12, dtype=np.uint8).reshape(3, 4), materials=MATERIALS[1:])


@pytest.fixture
def path(tmp_path):
    scene = clbvh.Scene(MESH)
    scene.place(scene.add(DOTS))
    scene.place(scene.add(clbvh.make_shape("icosphere", triangles=20)))
    scene.save(tmp_path / "a.scene")
    return tmp_path / "a.scene"


def same_texture(first, second):
    np.testing.assert_array_equal(first.pixels, second.pixels)
    return (first.name, first.is_srgb, first.wrap) == (second.name, second.is_srgb, second.wrap)


def test_looks_come_back(path):
    mesh, dots, ball = (geometry.shape for geometry in clbvh.Scene.load(path).geometries)
    for name in ("normals", "uvs", "colours", "material_ids"):
        values = getattr(mesh.appearance, name)
        np.testing.assert_array_equal(values, getattr(MESH.appearance, name))
        assert values.dtype == getattr(MESH.appearance, name).dtype
    np.testing.assert_array_equal(dots.appearance.colours, DOTS.appearance.colours)
    assert dots.appearance.material_ids is None
    assert ball.appearance is None
    assert (mesh.parts, ball.parts) == (MESH.parts, ())
    tiles, lamp = mesh.appearance.materials
    assert same_texture(tiles.base_colour_texture, TEXTURE)
    # Stored once, and shared again.
    assert tiles.base_colour_texture is lamp.emission_texture
    assert dots.appearance.materials == (lamp,)
    assert tiles == dataclasses.replace(MATERIALS[0], base_colour_texture=tiles.base_colour_texture)
    assert same_texture(lamp.metallic_roughness_texture, PLAIN)
    textures = {
        "emission_texture": lamp.emission_texture,
        "metallic_roughness_texture": lamp.metallic_roughness_texture,
    }
    assert lamp == dataclasses.replace(MATERIALS[1], **textures)


def test_a_scene_that_comes_back_is_saved_to_the_same_bytes(path, tmp_path):
    clbvh.Scene.load(path).save(tmp_path / "b.scene")
    assert (tmp_path / "b.scene").read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (["textures"], 5, "Expected `array`, got `int`"),
        (["textures"], [], "IndexError"),
        (["textures", 0], 5, "Expected `object`, got `int`"),
        (["textures", 0, "wrap"], "spiral", "Expected `array`, got `str`"),
        (["textures", 0, "wrap"], ["spiral", "clamp"], "two of repeat"),
        (["geometries", 0, "materials"], {}, "Expected `array`, got `object`"),
        (["geometries", 0, "materials"], [], "face 0 has the material 0, but there are 0 materials"),
        (["geometries", 0, "materials", 0], 5, "Expected `object`, got `int`"),
        (["geometries", 0, "materials", 0, "spin"], 5, "unknown field `spin`"),
        (["geometries", 0, "materials", 0, "ior"], 10**400, "out of range"),
        (["geometries", 0, "materials", 0, "ior"], 0.5, "ior must be a number from 1 to 100"),
        (["geometries", 0, "materials", 0, "base_colour"], None, "Expected `array`, got `null`"),
        (["geometries", 0, "materials", 0, "base_colour_texture"], 2, "IndexError"),
        (["geometries", 0, "materials", 0, "base_colour_texture"], -1, "Expected `int` >= 0"),
        (["geometries", 0, "parts", 0, 2], 3, "."),
    ],
    ids=str,
)
def test_a_forged_text_is_refused(path, keys, value, message):
    text, arrays = split(path)
    table = text
    for key in keys[:-1]:
        table = table[key]
    table[keys[-1]] = value
    forge(path, text, arrays)
    with pytest.raises(SceneError, match=message):
        clbvh.Scene.load(path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("geometry_0_normals", "no direction"),
        ("geometry_0_uvs", "not finite"),
        ("geometry_0_colours", "colours must be uint8"),
        ("geometry_0_material_ids", "material_ids must be integers"),
        ("geometry_1_colours", "colours must be uint8"),
        ("texture_0", "pixels must be uint8"),
    ],
)
def test_forged_arrays_are_refused(path, name, message):
    text, arrays = split(path)
    arrays[name] = np.full(arrays[name].shape, np.nan, np.float32)
    forge(path, text, arrays)
    with pytest.raises(SceneError, match=message):
        clbvh.Scene.load(path)
