"""Textures of normals: a constant one shades as a surface with the normals that it means."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

import clbvh
from clbvh import Light, Scene

POINTS = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
FACES = np.array([(0, 1, 2), (0, 2, 3)])
TEXEL = (190, 90, 220)
BEND = 2 * np.array(TEXEL) / 255 - 1
MAP = clbvh.Texture("tilt", np.tile(np.uint8(TEXEL), (2, 2, 1)), is_srgb=False)

# Directed light alone: rays of ambient light around a tilted normal may meet the plane itself.
LIGHT = Light(direction=(0.3, 0.4, 1), sky=(0, 0, 0), ground=(0, 0, 0))


def make_mesh(uvs=None, normal=(0, 0, 1), scale=1.0, texture=None):
    material = clbvh.Material("a", roughness=0.4, normal_texture=texture, normal_scale=scale)
    normals = np.tile(np.asarray(normal, float), (2, 3, 1))
    return clbvh.Mesh.from_arrays(
        POINTS, FACES, appearance=clbvh.Appearance(normals=normals, uvs=uvs, materials=[material])
    )


def show(mesh, side=1, light=LIGHT, matrix=None, **settings):
    fov = np.degrees(2 * np.arctan(1 / 4))
    light = replace(light, direction=tuple(side * np.array(light.direction)))
    scene = Scene(mesh if matrix is None else None)
    view = clbvh.View(
        eye=(0, 0, 4 * side), look_at=(0, 0, 0), up="y", fov=fov, width=12, height=12, ground=False, samples=2,
        light=light, **settings,
    )  # fmt: skip
    if matrix is not None:
        scene.place(scene.add(mesh), matrix)
    with clbvh.Renderer(scene, view) as renderer:
        return renderer.render(keeps_film=True).film[1:-1, 1:-1, :3]


def place(degrees, mirror):
    """Texture coordinates whose u grows along a direction, and the normal that the texture means."""
    angle = np.radians(degrees)
    along_u = np.array([np.cos(angle), np.sin(angle), 0])
    along_v = mirror * np.cross((0, 0, 1), along_u)
    uvs = np.stack((POINTS @ along_u, POINTS @ along_v), axis=-1)[FACES]
    return uvs, along_u, along_v


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("mirror", [1, -1])
@pytest.mark.parametrize("degrees", [0, 130])
def test_a_constant_map_is_a_tilted_normal(degrees, mirror, side):
    uvs, along_u, along_v = place(degrees, mirror)
    meant = BEND[0] * along_u + BEND[1] * along_v + BEND[2] * np.array([0, 0, 1])
    expected = show(make_mesh(normal=meant), side)
    np.testing.assert_allclose(show(make_mesh(uvs, texture=MAP), side), expected, rtol=1e-3)
    assert np.abs(show(make_mesh(), side) / expected - 1).max() > 0.01


def test_ambient_light_is_that_on_a_tilted_normal_and_meets_no_surface():
    uvs, *_ = place(0, 1)
    light = Light(direction=(0, 0, 1), colour=(0, 0, 0), sky=(0.1, 0.2, 0.3), ground=(0.3, 0.1, 0.0))
    found, tilted = (show(mesh, light=light) for mesh in (make_mesh(uvs, texture=MAP), make_mesh(normal=BEND)))
    np.testing.assert_allclose(np.median(found, axis=(0, 1)), np.median(tilted, axis=(0, 1)), rtol=1e-2)
    # The surface of the mesh is a plane, which keeps no light off itself.
    np.testing.assert_allclose(found, np.broadcast_to(np.median(found, axis=(0, 1)), found.shape), rtol=0.05)


@pytest.mark.parametrize("scale", [0.0, 0.5, -1.0])
def test_a_scale_bends_less_or_the_other_way(scale):
    uvs, along_u, along_v = place(20, 1)
    meant = scale * (BEND[0] * along_u + BEND[1] * along_v) + BEND[2] * np.array([0, 0, 1])
    np.testing.assert_allclose(show(make_mesh(uvs, scale=scale, texture=MAP)), show(make_mesh(normal=meant)), rtol=1e-3)


def test_the_light_is_that_of_a_tilted_plane_by_formula():
    # Of the directed light nine tenths arrive in `studio`. A second picture, of a black surface, takes the highlight
    # away.
    uvs, *_ = place(0, 1)
    normal = BEND / np.linalg.norm(BEND)
    to_light = np.array([0.3, 0.4, 1]) / np.linalg.norm([0.3, 0.4, 1])
    light = dataclasses.replace(LIGHT, colour=(0.5, 0.25, 0.1))
    normals = np.tile((0.0, 0.0, 1.0), (2, 3, 1))

    def draw(colour):
        material = clbvh.Material("a", base_colour=(colour,) * 3, normal_texture=MAP)
        looks = clbvh.Appearance(normals=normals, uvs=uvs, materials=[material])
        return show(clbvh.Mesh.from_arrays(POINTS, FACES, appearance=looks), light=light)

    expected = 0.9 * 0.8 * np.array(light.colour) * (normal @ to_light)
    np.testing.assert_allclose(draw(0.8) - draw(0.0), np.broadcast_to(expected, (10, 10, 3)), rtol=1e-3)


def test_facets_are_bent_as_well():
    uvs, *_ = place(0, 1)
    material = clbvh.Material("a", roughness=0.4, normal_texture=MAP)
    mesh = clbvh.Mesh.from_arrays(POINTS, FACES, appearance=clbvh.Appearance(uvs=uvs, materials=[material]))
    np.testing.assert_allclose(show(mesh, smooth=0.0), show(make_mesh(normal=BEND)), rtol=1e-3)


def test_a_texture_without_coordinates_bends_nothing():
    assert np.array_equal(show(make_mesh(texture=MAP)), show(make_mesh()))


@pytest.mark.parametrize("scale", [(-1, 1, 1), (2, 2, 2)])
def test_placed_meshes_are_bent_as_well(scale):
    uvs, along_u, along_v = place(130, -1)
    meant = BEND[0] * along_u + BEND[1] * along_v + BEND[2] * np.array([0, 0, 1])
    matrix = np.diag([*scale, 1.0])
    found, expected = (show(mesh, matrix=matrix) for mesh in (make_mesh(uvs, texture=MAP), make_mesh(normal=meant)))
    np.testing.assert_allclose(found, expected, rtol=1e-3)
