"""Pictures of all kinds of cameras: their pixels are the hits of the host's rays, whatever the layout."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh import Camera, Fisheye, Orthographic, Panorama, RenderOptions

WIDTH, HEIGHT = 96, 72
K = [[90.0, 2.0, 44.0], [0, 85.0, 39.0], [0, 0, 1]]
FRAME = {"eye": (2.5, 1.5, 3.0), "look_at": (0.1, 0, 0.2)}

CAMERAS = {
    "distorted": Camera.from_intrinsics(
        K, Camera(**FRAME).camera_to_world(), (WIDTH, HEIGHT), distortion=(-0.28, 0.11, 0.003, -0.004, -0.02)
    ),
    "orthographic": Camera(**FRAME, projection=Orthographic(2.2)),
    "fisheye": Camera(**FRAME, projection=Fisheye(120)),
    "fisheye-inside": Camera(eye=(0, 0, 0), look_at=(1, 0, 0), projection=Fisheye(360)),
    "panorama": Camera(eye=(0.6, 0.1, 0), look_at=(1, 0.2, 0), projection=Panorama()),
}

MESH = clbvh.make_shape("knot", triangles=500)


def two_objects():
    scene = clbvh.Scene()
    knot = scene.add(MESH)
    scene.place(knot)
    scene.place(knot, clbvh.Transform(scale=0.4, translate=(0.5, 0.8, 0.3)))
    scene.place(scene.add(clbvh.Spheres([[0, 0, 0]], 0.3)))
    return scene


LAYOUTS = ("bvh2", "bvh8")
VIEW = clbvh.View(width=WIDTH, height=HEIGHT, shading="lambert+shadow", up="y")


@pytest.fixture(scope="module", params=["mesh", "scene"])
def pictures(request):
    """The pictures of one mesh or of three objects, by layout and camera."""
    subject = MESH if request.param == "mesh" else two_objects()
    found = {}
    for layout in LAYOUTS:
        with clbvh.Renderer(subject, VIEW, RenderOptions(layout=layout, validate=True)) as renderer:
            found |= {(layout, name): renderer.render(camera=camera) for name, camera in CAMERAS.items()}
            for name in ("fisheye", "panorama"):
                found[layout, name, "depth"] = renderer.render(camera=CAMERAS[name], shading="depth")
    return found


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", CAMERAS)
def test_a_picture_has_the_hits_of_a_slow_reference(pictures, name, layout):
    camera, picture = CAMERAS[name], pictures[layout, name]
    assert picture.validated_pixels > 0
    is_hit = picture.hits.is_hit
    assert is_hit.mean() > 0.02
    assert not is_hit[~camera.sees(WIDTH, HEIGHT)].any()
    # Hits are projected back to the centres of their pixels.
    pixels, depth = camera.project(picture.hits.locations[is_hit], WIDTH, HEIGHT)
    rows, columns = np.nonzero(is_hit)
    np.testing.assert_allclose(pixels, np.stack((columns, rows), axis=1) + 0.5, rtol=0, atol=1e-7)
    np.testing.assert_allclose(picture.depth[is_hit], depth, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", CAMERAS)
def test_layouts_agree(pictures, name):
    first, second = (pictures[layout, name] for layout in LAYOUTS)
    np.testing.assert_array_equal(second.rgb, first.rgb)
    np.testing.assert_array_equal(second.hits.prim_id, first.hits.prim_id)


@pytest.mark.parametrize("name", ["fisheye", "fisheye-inside"])
def test_a_fisheye_is_black_outside_its_circle(pictures, name):
    picture, is_seen = pictures["bvh2", name], CAMERAS[name].sees(WIDTH, HEIGHT)
    assert (picture.rgb[~is_seen] == 0).all()
    assert (picture.rgb[is_seen].max(axis=1) > 0).all()


@pytest.mark.parametrize("name", ["fisheye", "panorama"])
def test_a_depth_picture_of_all_directions_shows_distances(pictures, name):
    picture = pictures["bvh2", name, "depth"]
    is_hit = picture.hits.is_hit
    order = np.argsort(picture.hits.t[is_hit])
    grey = picture.rgb[is_hit][order, 0].astype(int)
    assert (np.diff(grey) <= 1).all()
    assert np.ptp(grey) > 20


def test_a_renderer_frames_for_each_projection():
    with clbvh.Renderer(MESH, width=WIDTH, height=HEIGHT, shading="normal", projection=Orthographic()) as renderer:
        assert renderer.camera.projection.height > 0
        found = [renderer.render(camera=camera).found["prim_id"] >= 0 for camera in renderer.turntable(3)]
    assert all(0.05 < is_hit.mean() < 0.9 for is_hit in found)
    assert not any(is_hit[[0, -1]].any() or is_hit[:, [0, -1]].any() for is_hit in found)
