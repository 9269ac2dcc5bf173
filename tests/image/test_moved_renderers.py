"""A renderer whose objects move: its pictures are those of a new renderer of the moved scene, to the last bit."""

import numpy as np
import pytest

import clbvh
from clbvh import (
    Camera,
    EnvironmentMap,
    Material,
    QueryError,
    Renderer,
    RenderOptions,
    Scene,
    SceneError,
    Spheres,
    Transform,
)

from ..concurrency.threads import run_in_threads
from .test_pictures import KNOT, same_picture

LAMP = Material("lamp", emission=(5.0, 4.0, 3.0))
NAMES = ("knot", "panel", "glow")
# A turn, a light that moves, and spheres of light that are stretched: paths no longer draw them.
POSES = (
    (Transform(rotate=(0, 40, 10)), Transform(translate=(1, 2, 1)), Transform(scale=0.3, translate=(-1, 1, 0))),
    (Transform(translate=(0.3, 0, 0)), Transform(rotate=(90, 0, 0)), Transform((0.3, 0.1, 0.3), (0, 0, 0), (-1, 1, 0))),
)
SIZE = {"width": 48, "height": 36}
CHANNELS = ("depth", "shading_normal", "position", "prim_id", "instance_id")
SKY = EnvironmentMap(np.linspace(0, 1, 4 * 8 * 3).reshape(4, 8, 3))
SETTINGS = [
    {"shading": "studio", "samples": 3},
    {"shading": "lambert+shadow"},
    {"shading": "path", "samples": 3},
    {"shading": "path", "samples": 3, "camera": Camera((0, 1, 6), (0, 0, 0)), "environment": SKY},
]


@pytest.fixture(scope="module")
def scene():
    scene = Scene()
    panel = scene.add(([[0, 0, 0], [1, 0, 0], [0, 0, 1]], [[0, 1, 2]]), name="panel")
    scene.place(scene.add(KNOT), name="knot", colour=(0.8, 0.2, 0.1))
    scene.place(panel, Transform(translate=(0, 2, 0)), name="panel", material=LAMP)
    scene.place(scene.add(Spheres([[0, 0, 0], [1, 0, 0]], 0.4)), name="glow", material=LAMP)
    scene.place(panel, Transform(scale=4, translate=(-2, -1, -2)), name="floor")
    return scene


def move(scene, pose):
    """Return a scene of its own with instances in other places."""
    state = scene.snapshot()
    ids = [scene.find(name).id for name in NAMES]
    return Scene.from_state(state.with_transforms(ids, [each.matrix for each in pose]))


@pytest.mark.parametrize("settings", SETTINGS, ids=["studio", "lambert+shadow", "path", "path in an environment"])
def test_pictures_are_those_of_a_new_renderer(scene, settings):
    with Renderer(scene, **SIZE, **settings) as renderer:
        renderer.render()
        for pose in POSES:
            renderer.set_transforms(NAMES, [*pose])
            with Renderer(move(scene, pose), **SIZE, **settings) as new:
                moved, expected = renderer.render(), new.render()
                assert same_picture(moved, expected)
                assert moved.hits.locations.tobytes() == expected.hits.locations.tobytes()
                assert renderer.turntable(3) == new.turntable(3)
                images, of_new = renderer.images(CHANNELS), new.images(CHANNELS)
                assert all(images[name].tobytes() == of_new[name].tobytes() for name in CHANNELS)
        assert renderer.scene.find("knot").transform[0, 3] == 0


@pytest.mark.parametrize("settings", SETTINGS, ids=["studio", "lambert+shadow", "path", "path in an environment"])
def test_removed_instances_are_not_drawn(scene, settings):
    rest = Scene()
    for one in (scene.find("knot"), scene.find("floor")):
        rest.place(rest.add(one.geometry.shape), one.matrix, name=one.name, colour=one.colour)
    with Renderer(scene, **SIZE, **settings) as renderer:
        before = renderer.render()
        renderer.tracer.set_masks(["panel", "glow"], 0)  # the light
        picture, expected = renderer.render(), clbvh.render(rest, **SIZE, **settings)
        assert picture.camera == expected.camera
        # By `path` the others are one mesh, where nothing is removed.
        assert np.abs(picture.rgb.astype(int) - expected.rgb).mean() <= 0.05 * (settings["shading"] == "path")
        renderer.tracer.set_masks(scene.instances, 0)
        camera = Camera((0, 1, 6), (0, 0, 0))
        assert renderer.render(camera=camera).report()["hits"] == 0
        if "camera" not in settings:
            with pytest.raises(SceneError, match="nothing that a camera could frame"):
                renderer.render()
        renderer.tracer.set_masks(scene.instances, 1)
        assert same_picture(renderer.render(), before)


def test_the_second_pose_of_a_motion_begins_where_an_instance_is(scene):
    with Renderer(scene, **SIZE) as renderer:
        renderer.set_transforms(NAMES, [*POSES[0]])
        still = renderer.images("motion", next_transforms=dict(zip(NAMES, POSES[0], strict=True)))["motion"]
        assert np.nanmax(np.abs(still)) < 1e-9


@pytest.mark.parametrize("builder", ["sah", "brute"])
def test_a_lone_mesh_moves_and_comes_back(builder):
    options, view = RenderOptions(builder=builder, validate=True), {**SIZE, "shading": "lambert"}
    there = Scene()
    there.place(there.add(KNOT), Transform(translate=(3, 0, 0)))
    with Renderer(KNOT, options=options, **view) as renderer:
        before = renderer.render()
        renderer.set_transforms(0, Transform(translate=(3, 0, 0)))
        assert same_picture(renderer.render(), clbvh.render(there, options=options, **view))
        assert renderer.mesh is None
        renderer.set_transforms(0, np.eye(4))
        assert same_picture(renderer.render(), before)
        assert renderer.mesh is not None


def test_buffers_of_older_poses_are_given_back(scene):
    with Renderer(scene, **SIZE, shading="path", samples=2) as renderer:
        counts = set()
        for step in range(6):
            renderer.set_transforms("knot", Transform(translate=(step, 0, 0)))
            renderer.render()
            counts.add(renderer._session.buffer_count)
        assert len(counts) == 1


def test_threads_see_whole_poses(scene):
    view = {**SIZE, "shading": "lambert+shadow"}
    expected = [clbvh.render(move(scene, pose), **view) for pose in POSES]
    with Renderer(move(scene, POSES[0]), **view) as renderer:

        def draw():
            for _ in range(30):
                picture = renderer.render()
                pose = int(same_picture(picture, expected[1]))
                assert same_picture(picture, expected[pose])
                # The hits are computed later, on the surfaces of the picture.
                assert picture.hits.t.tobytes() == expected[pose].hits.t.tobytes()

        def move_on():
            for step in range(1, 40):
                renderer.set_transforms(NAMES, [*POSES[step % 2]])

        run_in_threads(draw, draw, move_on)


def test_wrong_moves_are_refused_and_change_nothing(scene):
    scene = scene.copy()
    with Renderer(scene, **SIZE, shading="lambert") as renderer:
        before = renderer.render()
        scene.place(scene.geometries[0], name="late")
        for wrong, words in (("nobody", r"no instance 'nobody'; it has 'knot', "), ("late", "placed after")):
            with pytest.raises(SceneError, match=words):
                renderer.set_transforms(wrong, np.eye(4))
        assert same_picture(renderer.render(), before)
    with pytest.raises(QueryError, match="closed"):
        renderer.set_transforms("knot", np.eye(4))
