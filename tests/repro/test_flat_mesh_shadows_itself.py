"""Triangles in a plane of the local axes, as those of a flat mesh, were in their own shadow.

The distance from a surface at which rays leave it comes from the rounding of its position, and there is none across
such a plane: the rays began on the triangle, and met it at t = 0.
"""

from __future__ import annotations

import numpy as np
import pytest

import clbvh

CAMERA = clbvh.Camera((0, 0, 9), (0, 0, 0))
FLAT = clbvh.Mesh.from_arrays([[-1, -1, 0], [1, -1, 0], [0, 2, 0]], [[0, 1, 2]])


@pytest.mark.parametrize("copies", [1, 2])
@pytest.mark.parametrize("is_turned", [False, True])
def test_a_flat_mesh_is_lit(copies, is_turned):
    scene = clbvh.Scene()
    view = clbvh.View(ground=False, light=clbvh.Light((0, 0, 1)))
    flat = scene.add(FLAT)
    for number in range(copies):
        scene.place(flat, clbvh.Transform(rotate=(0, 180.0 * is_turned, 0), translate=(9.0 * number, 0, 0)))
    size = {"camera": CAMERA, "width": 9, "height": 9}
    with clbvh.Renderer(scene, view) as renderer:
        plain, shadowed = (renderer.render(shading=name, **size).rgb for name in ("lambert", "lambert+shadow"))
        occluded = renderer.render(shading="ao", **size).rgb
    np.testing.assert_array_equal(shadowed, plain)
    # Sample 0 alone is not enough: no ray of any sample meets the triangle.
    assert occluded[4, 4].min() > 200


def test_layers_of_clear_panes_are_passed():
    panes = np.array([[[-1, -1, z], [1, -1, z], [0, 2, z]] for z in (-1, 0, 1)], float)
    appearance = clbvh.Appearance(materials=(clbvh.Material(alpha=0.0),))
    mesh = clbvh.Mesh.from_arrays(panes.reshape(-1, 3), np.arange(9).reshape(3, 3), appearance=appearance)
    picture = clbvh.render(mesh, ground=False, transparent=True, camera=CAMERA, width=9, height=9, samples=2)
    assert not picture.alpha.any()
