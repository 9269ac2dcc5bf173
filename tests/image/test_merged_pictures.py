"""Pictures of merged meshes: each instance keeps its material, texture, normals and light, as if nothing was merged."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh import Appearance, Cut, Material, Mesh, Renderer, RenderOptions, Scene, Texture
from clbvh.trace.scene import merging

WIDTH, HEIGHT = 80, 64
PIXELS = np.random.default_rng(2).integers(30, 256, (8, 8, 4)).astype(np.uint8) | np.array([0, 0, 0, 255], np.uint8)
MATERIALS = (
    Material("red", base_colour=(0.9, 0.1, 0.1)),
    Material("lamp", emission=(6, 5, 4)),
    Material("metal", base_colour=(0.9, 0.8, 0.3), metallic=1, roughness=0.3),
    Material("glass", transmission=1, roughness=0),
    Material("tiles", base_colour_texture=Texture("tiles", PIXELS), normal_texture=Texture("bumps", PIXELS)),
    None,
)


def turn(generator, side=1.0):
    matrix = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    return matrix * np.sign(np.linalg.det(matrix)) * side


def make_shape(index, generator):
    """A ball or a knot with texture coordinates, and some with colours and with normals that are not smooth ones."""
    shape = clbvh.make_shape(("icosphere", "knot")[index % 2], triangles=300)
    count = shape.face_count
    normals = None
    if index % 3 == 1:
        corners = shape.vertices[shape.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        normals = across[:, None] + generator.normal(size=(count, 3, 3)) * 0.1
    colours = None
    if index % 4 == 2:
        colours = generator.integers(100, 256, (count, 3, 4)).astype(np.uint8) | np.array([0, 0, 0, 255], np.uint8)
    own = (Material("own", base_colour=(0.2, 0.5, 0.9)), Material("other", base_colour=(0.1, 0.9, 0.2)))
    looks = Appearance(
        uvs=generator.random((count, 3, 2)), normals=normals, colours=colours, materials=own,
        material_ids=generator.integers(2, size=count),
    )  # fmt: skip
    return Mesh.from_arrays(shape.vertices, shape.faces, appearance=looks)


def make_scene(materials=MATERIALS, **settings):
    """Twelve meshes, half of them mirrored, under maps that keep angles; those that shear interpolate other normals."""
    generator = np.random.default_rng(7)
    scene = Scene(width=WIDTH, height=HEIGHT, samples=4, **settings)
    for index in range(12):
        transform = np.eye(4)
        transform[:3, :3] = turn(generator, 1 if index < 6 else -1) * generator.uniform(0.5, 1.5)
        transform[:3, 3] = generator.uniform(-2.5, 2.5, 3)
        colour = (0.1, 0.9, 0.9) if index == 5 else None
        shape = scene.add(make_shape(index, generator))
        scene.place(shape, transform, material=materials[index % len(materials)], colour=colour)
    return scene


def draw(scene, **changes):
    with Renderer(scene, options=RenderOptions()) as renderer:
        return renderer.render(keeps_film=True, **changes)


def draw_both(scene, **changes):
    picture = draw(scene, **changes)
    assert [len(merged.merged_ids) for merged in picture.objects.merging.meshes] == [6, 6]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(merging, "find_groups", lambda *_: [])
        expected = draw(scene, **changes)
    assert len(expected.objects.merging.meshes) == 0
    return picture, expected


@pytest.mark.parametrize("cut", [None, Cut.plane((0.3, 1, 0), (0, 0.5, 0))], ids=["whole", "cut"])
@pytest.mark.parametrize(("shading", "smooth"), [("studio", 0), ("studio", 40), ("ao", 0), ("path", 40)])
def test_materials_are_those_of_the_instances(shading, smooth, cut):
    picture, expected = draw_both(make_scene(shading=shading, smooth=smooth, cut=cut))
    one, other = (each.film[..., :3].astype(np.float64) for each in (picture, expected))
    # Of the few pixels that differ, paths of light that pass an edge on the other side are most.
    close = np.isclose(one, other, rtol=0.02, atol=0.02).all(axis=-1)
    assert close.mean() > (0.9 if shading == "path" else 0.985)
    assert one[close].mean() == pytest.approx(other[close].mean(), rel=1e-3)
    assert other.std() > 0.05


@pytest.mark.parametrize("smooth", [0, 40])
def test_bumps_are_those_of_the_instances(smooth):
    bumpy = Material("bumpy", normal_texture=Texture("bumps", PIXELS))
    picture, expected = draw_both(make_scene((bumpy,), shading="studio", smooth=smooth))
    close = np.isclose(picture.film, expected.film, rtol=0.02, atol=0.02).all(axis=-1)
    assert close.mean() > 0.985


def test_each_channel_of_images_is_the_same():
    channels = ("depth", "normal", "shading_normal", "position", "instance_id", "geometry_id", "primitive_id", "uv")
    images = clbvh.render_images(make_scene(), channels)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(merging, "find_groups", lambda *_: [])
        expected = clbvh.render_images(make_scene(), channels)
    same = (images["primitive_id"] == expected["primitive_id"]) & (images["instance_id"] == expected["instance_id"])
    assert same.mean() > 0.998
    assert len(np.unique(images["instance_id"])) > 8
    for channel in channels:
        np.testing.assert_array_equal(images[channel][same], expected[channel][same], channel)
