"""Scenes whose instances paths see as one mesh: the picture and the hits of the instances themselves."""

import numpy as np
import pytest

import clbvh
from clbvh import Appearance, Material, Renderer, Scene, Spheres, Transform
from clbvh.rendering import joined_scene

from .test_pictures import KNOT, same_picture

VIEW = {"eye": (0, 0.8, 6), "look_at": (0, 0.5, 0), "up": "y"}
SETTINGS = {"shading": "path", "width": 48, "height": 36, "samples": 8, "surface": (0.2, 0.5, 0.7), **VIEW}
LAMP = Material("lamp", emission=(5.0, 4.0, 3.0))


def make_scene():
    """A mesh twice, bare and in a colour of its own; a flat lamp; and corners with colours on a turned floor."""
    scene = Scene()
    knot, panel = scene.add(KNOT), ([[0, 0, 0], [1, 0, 0], [0, 0, 1]], [[0, 1, 2]])
    scene.place(knot)
    scene.place(knot, Transform(0.5, (0, 40, 10), (1.5, 0.5, 0)), name="moves", colour=(0.8, 0.2, 0.1))
    scene.place(scene.add(panel), Transform(translate=(0, 2, 0)), material=LAMP)
    tints = Appearance(colours=np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255]]], np.uint8))
    floor = clbvh.Mesh.from_arrays(*panel, appearance=tints)
    scene.place(scene.add(floor), Transform(6, (0, 20, 0), (-2, -1, -2)))
    return scene


def test_the_picture_is_that_of_the_instances(monkeypatch):
    joined = clbvh.render(make_scene(), **SETTINGS)
    monkeypatch.setattr(joined_scene, "can_join", lambda scene: False)
    apart = clbvh.render(make_scene(), **SETTINGS)
    for name in ("geometry_id", "instance_id", "prim_id"):
        np.testing.assert_array_equal(getattr(joined.hits, name), getattr(apart.hits, name))
    assert len(np.unique(joined.hits.instance_id)) == 5  # four, and misses
    np.testing.assert_allclose(joined.hits.t, apart.hits.t, rtol=1e-12)
    np.testing.assert_allclose(joined.found["t"], apart.found["t"], rtol=1e-5)
    # A path may take another turn where float32 rounds differently; few do.
    difference = np.abs(joined.rgb.astype(int) - apart.rgb).max(axis=-1)
    assert (difference <= 1).mean() > 0.97
    assert abs(joined.rgb.mean() - apart.rgb.mean()) < 0.2


def test_a_moved_renderer_joins_anew():
    pose = Transform(0.5, (0, 10, 0), (-1.5, 1, 0))
    scene = make_scene()
    with Renderer(scene, **SETTINGS) as renderer:
        before = renderer.render()
        renderer.set_transforms("moves", pose)
        after = renderer.render()
        other_surface = renderer.render(surface=(0.9, 0.1, 0.1))
    state = scene.snapshot().with_transforms([1], [pose.matrix])
    same_picture(after, clbvh.render(Scene.from_state(state), **SETTINGS))
    assert (before.rgb != after.rgb).any()
    assert other_surface.rgb[..., 0].mean() > after.rgb[..., 0].mean()


@pytest.mark.parametrize(
    "odd",
    [
        lambda scene: scene.place(scene.add(Spheres([[0, 0, 0]], 0.4))),
        lambda scene: scene.place(scene.instances[0].geometry, Transform(scale=(-1, 1, 1))),
        lambda scene: scene.place(scene.instances[0].geometry, Transform(scale=1e-4)),
        lambda scene: scene.place(scene.instances[0].geometry, mask=0),
    ],
    ids=["spheres", "mirrored", "small", "hidden"],
)
def test_what_one_mesh_cannot_show_stays_in_instances(odd):
    scene = make_scene()
    with Renderer(scene, **SETTINGS) as renderer:
        assert joined_scene.can_join(renderer.render().scene)
    odd(scene)
    with Renderer(scene, **SETTINGS) as renderer:
        assert not joined_scene.can_join(renderer.render().scene)
