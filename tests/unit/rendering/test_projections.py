"""Orthographic, fisheye and panoramic cameras: their rays by formula, the way back, and their pictures."""

import numpy as np
import pytest

import clbvh
from clbvh import Camera, Fisheye, Lens, Orthographic, Panorama, SceneError

FRAME = {"eye": (2.5, 1.5, 3.0), "look_at": (0.1, 0, 0.2), "up": (0.1, 1.0, 0.2)}
DOWN_Z = {"eye": (0, 0, 0), "look_at": (0, 0, -1)}
K = [[90.0, 2.0, 44.0], [0, 85.0, 39.0], [0, 0, 1]]
POSE = Camera(**FRAME).camera_to_world()
WIDTH, HEIGHT = 96, 72

CAMERAS = {
    "perspective": Camera(**FRAME),
    "lens": Camera.from_intrinsics(K, POSE, (WIDTH, HEIGHT)),
    "distorted": Camera.from_intrinsics(K, POSE, (WIDTH, HEIGHT), distortion=(-0.28, 0.11, 0.003, -0.004, -0.02)),
    "orthographic": Camera(**FRAME, projection=Orthographic(2.2)),
    "fisheye": Camera(**FRAME, projection=Fisheye(60)),
    "fisheye-inside": Camera(eye=(0, 0, 0), look_at=(1, 0, 0), projection=Fisheye(360)),
    "panorama": Camera(eye=(0.6, 0.1, 0), look_at=(1, 0.2, 0), projection=Panorama()),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_a_point_on_a_ray_is_projected_to_where_the_ray_comes_from(name):
    camera = CAMERAS[name]
    pixels = np.random.default_rng(5).uniform(0, (WIDTH, HEIGHT), (300, 2))
    if name.startswith("fisheye"):
        pixels = pixels[np.hypot(*(pixels - [WIDTH / 2, HEIGHT / 2]).T) < 0.999 * HEIGHT / 2]
    origins, directions = camera.rays_at(pixels, WIDTH, HEIGHT)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=0, atol=1e-15)
    points = origins + np.random.default_rng(6).uniform(0.1, 1000, (len(pixels), 1)) * directions
    found, depth = camera.project(points, WIDTH, HEIGHT)
    np.testing.assert_allclose(found, pixels, rtol=0, atol=1e-8)
    np.testing.assert_allclose(depth, (points - camera.eye) @ camera.axes()[2], rtol=0, atol=1e-10)
    # The rays of a picture are those through its pixel centres, and depth is t times the cosine.
    whole = camera.rays(WIDTH, HEIGHT)
    centres = np.stack(np.mgrid[:HEIGHT, :WIDTH][::-1], axis=-1) + 0.5
    for part, of_pictures in zip(camera.rays_at(centres, WIDTH, HEIGHT), whole, strict=True):
        np.testing.assert_allclose(part, of_pictures, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(camera.rays(WIDTH, HEIGHT, range(3, 8))[0], whole[0][3:8])
    np.testing.assert_array_equal(camera.cosines(WIDTH, HEIGHT), whole[1] @ camera.axes()[2])


def test_orthographic_rays_are_parallel_and_fill_the_height():
    camera = Camera(eye=(1, 2, 10), look_at=(1, 2, 0), projection=Orthographic(3))
    origins, directions = camera.rays(4, 2)
    assert (directions == [0, 0, -1]).all()
    assert origins[:, 0, 1].tolist() == [2.75, 1.25]
    assert origins[0, :, 0].tolist() == [1 - 2.25, 1 - 0.75, 1 + 0.75, 1 + 2.25]
    pixels, depth = camera.project([[1 + 3, 2 + 1.5, 4], [1, 2, 11]], 4, 2)
    assert pixels[0].tolist() == [4, 0]
    assert np.isnan(pixels[1]).all()
    assert depth.tolist() == [6, -1]


def test_a_fisheye_is_equidistant_in_the_circle_that_touches_the_shorter_sides():
    for angle in (1e-3, 180, 360):
        radius = np.linspace(0, 1, 9)
        pixels = np.stack((100 + 50 * radius, np.full(9, 50.0)), axis=1)
        x, y, z = Camera(**DOWN_Z, projection=Fisheye(angle)).rays_at(pixels, 200, 100)[1].T
        np.testing.assert_allclose(np.arctan2(x, -z), np.radians(angle) / 2 * radius, rtol=1e-9, atol=1e-15)
        assert np.abs(y).max() < 1e-15
    for width, height in ((80, 60), (60, 80)):
        rows, columns = np.mgrid[:height, :width] + 0.5
        inside = np.hypot(columns - width / 2, rows - height / 2) <= 30
        np.testing.assert_array_equal(Camera(**FRAME, projection=Fisheye()).sees(width, height), inside)
    assert Camera(**FRAME).sees(3, 2).all()
    pixels, _ = Camera(**DOWN_Z, projection=Fisheye()).project([[0, 0, 1], [1, 0, 0.1], [0, 0, 0], [1, 0, 0]], 100, 100)
    assert np.isnan(pixels[:3]).all()
    assert pixels[3] == pytest.approx([100, 50])


def test_points_pixels_and_values_that_do_not_go_together_are_refused():
    camera, lens = Camera(**FRAME), Lens.from_fov(40, 64, 48)
    rows = [
        (lambda: camera.project([np.nan, 0, 0], 9, 9), "points that"),
        (lambda: camera.rays_at([1, 2, 3], 9, 9), "the pixels of rays"),
        (lambda: Camera(**FRAME, projection=Orthographic()), "needs a height"),
        (lambda: Camera(**FRAME, projection=Panorama(), lens=lens), "the panorama one has none"),
        (lambda: CAMERAS["panorama"].intrinsics(64, 48), "that of a perspective camera"),
    ]
    for call, words in rows:
        with pytest.raises(SceneError, match=words):
            call()


@pytest.mark.parametrize("name", CAMERAS)
def test_a_picture_has_the_hits_of_the_rays(mesh, world, name):
    camera = CAMERAS[name]
    for source in (mesh, world):
        view = clbvh.View(width=WIDTH, height=HEIGHT, shading="lambert+shadow", up="y")
        with clbvh.Renderer(source, view, clbvh.RenderOptions(validate=True)) as renderer:
            picture, depth = renderer.render(camera=camera), renderer.render(camera=camera, shading="depth")
        assert picture.validated_pixels > 0
        is_hit, is_seen = picture.hits.is_hit, camera.sees(WIDTH, HEIGHT)
        assert is_hit.mean() > 0.02
        assert not is_hit[~is_seen].any()
        assert (picture.rgb[~is_seen] == 0).all()
        assert (picture.rgb[is_seen].max(axis=1) > 0).all()
        # Hits are projected back to the centres of their pixels.
        pixels, expected = camera.project(picture.hits.locations[is_hit], WIDTH, HEIGHT)
        rows, columns = np.nonzero(is_hit)
        np.testing.assert_allclose(pixels, np.stack((columns, rows), axis=1) + 0.5, rtol=0, atol=1e-7)
        np.testing.assert_allclose(picture.depth[is_hit], expected, rtol=0, atol=1e-9)
        # A depth picture of all directions shows distances.
        is_wide = isinstance(camera.projection, Fisheye | Panorama)
        order = np.argsort((picture.hits.t if is_wide else picture.depth)[is_hit])
        grey = depth.rgb[is_hit][order, 0].astype(int)
        assert (np.diff(grey) <= 1).all()
        assert np.ptp(grey) > 20
