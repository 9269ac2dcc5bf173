"""Looks of trimesh objects: colours, textures and materials become an appearance."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import MultiMaterial, PBRMaterial, SimpleMaterial

import clbvh
from clbvh.geometry.appearance.srgb import srgb_to_linear
from clbvh.geometry.as_mesh import as_mesh

PIXELS = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)


def make_box(visual=None, **colours):
    box = trimesh.creation.box()
    box.visual = visual or ColorVisuals(box, **colours)
    return box


def random_bytes(*shape):
    return np.random.default_rng(0).integers(0, 256, shape, np.uint8)


def test_colours_of_vertices_and_faces():
    box = make_box(vertex_colors=random_bytes(8, 4))
    mesh = as_mesh(box)
    np.testing.assert_array_equal(mesh.appearance.colours, random_bytes(8, 4)[mesh.faces])
    looks = as_mesh(make_box(face_colors=random_bytes(12, 4))).appearance
    np.testing.assert_array_equal(looks.colours, np.repeat(random_bytes(12, 4)[:, None], 3, axis=1))
    assert looks.materials[0].base_colour == (1, 1, 1)
    assert as_mesh(trimesh.creation.box()).appearance is None


def test_a_simple_material():
    uvs = np.random.default_rng(0).random((8, 2))
    material = SimpleMaterial(image=Image.fromarray(PIXELS), diffuse=[255, 128, 0, 64], glossiness=98)
    looks = as_mesh(make_box(TextureVisuals(uv=uvs, material=material))).appearance
    np.testing.assert_array_equal(looks.uvs, np.float32(uvs)[trimesh.creation.box().faces])
    (read,) = looks.materials
    assert read.base_colour == pytest.approx(srgb_to_linear(np.array([255, 128, 0]) / 255))
    assert (read.alpha, read.roughness) == (64 / 255, pytest.approx(0.02**0.25))
    np.testing.assert_array_equal(read.base_colour_texture.pixels, PIXELS)


def test_a_physical_material():
    image = Image.fromarray(PIXELS)
    material = PBRMaterial(
        name="paint", baseColorFactor=[0, 51, 255, 102], metallicFactor=0.25, roughnessFactor=0.75, alphaMode="MASK",
        alphaCutoff=0.3, emissiveFactor=[1, 0.5, 0], baseColorTexture=image, metallicRoughnessTexture=image,
        normalTexture=image,
    )  # fmt: skip
    (read,) = as_mesh(make_box(TextureVisuals(uv=np.zeros((8, 2)), material=material))).appearance.materials
    assert read.base_colour == pytest.approx((0, 0.2, 1))
    assert (read.name, read.metallic, read.roughness, read.alpha_cutoff) == ("paint", 0.25, 0.75, 0.3)
    assert read.alpha == pytest.approx(0.4)
    assert read.emission == (1, 0.5, 0)
    np.testing.assert_array_equal(read.base_colour_texture.pixels, PIXELS)
    assert read.base_colour_texture.is_srgb
    assert not read.metallic_roughness_texture.is_srgb
    assert not read.normal_texture.is_srgb


def test_several_materials():
    materials = MultiMaterial([PBRMaterial(name="a"), PBRMaterial(name="b")])
    ids = np.arange(12) % 2
    visual = TextureVisuals(uv=np.zeros((8, 2)), material=materials, face_materials=ids)
    looks = as_mesh(make_box(visual)).appearance
    assert [material.name for material in looks.materials] == ["a", "b"]
    assert looks.material_ids.tolist() == ids.tolist()


def test_a_scene_of_trimesh_keeps_the_looks_of_its_parts():
    source = trimesh.Scene({"red": make_box(face_colors=np.tile([255, 0, 0, 255], (12, 1)).astype(np.uint8))})
    scene = clbvh.Scene()
    scene.add_parts(source)
    assert (scene.geometries[0].shape.appearance.colours == [255, 0, 0, 255]).all()


@pytest.mark.parametrize(
    ("visual", "message"),
    [
        (lambda: TextureVisuals(uv=np.full((8, 2), np.nan)), "texture coordinates cannot be used"),
        (lambda: TextureVisuals(uv=np.zeros((3, 2))), "texture coordinates cannot be used"),
        (lambda: TextureVisuals(uv=np.zeros((8, 2)), material=SimpleMaterial(image="wood.png")), "material cannot be"),
    ],
    ids=["nan", "few", "image"],
)
def test_what_cannot_be_used_is_one_warning(visual, message):
    box = make_box(visual())
    with pytest.warns(clbvh.AppearanceWarning, match=f"Trimesh: the {message}"):
        assert as_mesh(box).face_count == 12
