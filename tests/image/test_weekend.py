"""A small picture of the shipped scene `weekend`, and materials of instances in pictures of paths."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh

SIZE = {"width": 96, "height": 54}


@pytest.fixture(scope="module")
def weekend():
    scene, view = clbvh.open_scene("weekend")
    return scene, view.changed(samples=16, **SIZE)


def test_the_weekend_looks_as_it_did(compare_with_reference, weekend):
    compare_with_reference("weekend", clbvh.render(*weekend).rgb)


def test_the_large_spheres_are_metal_glass_and_chalk_from_front_to_back(weekend):
    spheres = weekend[0].geometries[0].shape
    hits = clbvh.render(*weekend, samples=1).hits
    # Of the three large spheres, the nearest one covers the most.
    seen = [int((hits.prim_id == number).sum()) for number in (3, 1, 2)]
    assert seen[0] > seen[1] > seen[2] > 0
    materials = spheres.appearance.materials
    assert [(each.metallic, each.transmission) for each in materials[1:4]] == [(0, 1), (0, 0), (1, 0)]


def test_an_instance_in_a_material_looks_like_a_geometry_in_it():
    lamp = clbvh.Material(base_colour=(0.2, 0.4, 0.6), emission=(0.5, 0.2, 0.1))
    ball = clbvh.make_shape("icosphere", triangles=320)
    looks = clbvh.Appearance(materials=(lamp,))
    settings = {"shading": "path", "samples": 2, **SIZE}
    pictures = []
    for shape, material in (
        (ball, lamp),
        (clbvh.Mesh.from_arrays(ball.vertices, ball.faces, appearance=looks), None),
        (clbvh.Mesh.from_arrays(ball.vertices, ball.faces, appearance=looks), clbvh.Material()),
    ):
        scene = clbvh.Scene()
        view = clbvh.View(**settings)
        geometry = scene.add(shape)
        scene.place(geometry, material=material)
        scene.place(geometry, clbvh.Transform(translate=(3, 0, 0)), material=material)
        pictures.append(clbvh.render(scene, view).rgb)
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])
