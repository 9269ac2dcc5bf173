"""Lens distortion: OpenCV's formula, its inverse, and lenses that have none."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Camera, Lens, SceneError

WIDTH, HEIGHT = 96, 72
SIZE = (WIDTH, HEIGHT)
K = np.array([[90.0, 2.0, 44.0], [0, 85.0, 39.0], [0, 0, 1]])
POSE = np.array([[0.36, 0.48, -0.8, 3], [-0.8, 0.6, 0, -2], [0.48, 0.64, 0.6, 1], [0, 0, 0, 1]])

LENSES = {
    "barrel": (-0.3, 0.09, 0.0, 0.0, 0.0),
    "pincushion": (0.4, 0.2, 0.0, 0.0, 0.1),
    "tangential": (0.0, 0.0, 0.02, -0.015, 0.0),
    "all": (-0.28, 0.11, 0.003, -0.004, -0.02),
    "moustache": (-0.2, 0.4, 0.0, 0.001, -0.1),
}


def project_as_opencv(points, k, world_to_camera, distortion):
    """`cv2.projectPoints`, by the formula in OpenCV's documentation of calib3d: pixels, and the depths."""
    x, y, z = (points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]).T
    x, y = x / z, y / z
    k1, k2, p1, p2, k3 = distortion
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    shown_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    shown_y = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    homogeneous = np.stack((shown_x, shown_y, np.ones_like(x)), axis=-1) @ k.T
    return homogeneous[:, :2], z


@pytest.mark.parametrize("pixel_centres", ["half", "integer"])
@pytest.mark.parametrize("name", LENSES)
def test_points_on_the_ray_of_a_pixel_are_projected_to_its_centre_by_opencv(name, pixel_centres):
    camera = Camera.from_intrinsics(K, POSE, SIZE, pixel_centres=pixel_centres, distortion=LENSES[name])
    origins, directions = camera.rays()
    distances = np.random.default_rng(1).uniform(0.5, 100, (HEIGHT, WIDTH, 1))
    pixels, _ = project_as_opencv(
        (origins + distances * directions).reshape(-1, 3), K, np.linalg.inv(POSE), LENSES[name]
    )
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + (0.5 if pixel_centres == "half" else 0.0)
    np.testing.assert_allclose(pixels, np.stack((columns, rows), axis=-1).reshape(-1, 2), rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", LENSES)
def test_points_are_projected_as_by_opencv(name):
    camera = Camera.from_intrinsics(K, POSE, SIZE, distortion=LENSES[name])
    inside = np.random.default_rng(2).uniform(0, SIZE, (500, 2))
    origins, directions = camera.rays_at(inside)
    points = origins + directions * 7
    expected, depth = project_as_opencv(points, K, np.linalg.inv(POSE), LENSES[name])
    pixels, depths = camera.project(points)
    np.testing.assert_allclose(pixels, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(pixels, inside, rtol=0, atol=1e-8)
    np.testing.assert_allclose(depths, depth, rtol=1e-12)


def test_a_smaller_picture_shows_the_same_view():
    camera = Camera.from_intrinsics(K, POSE, SIZE, distortion=LENSES["all"])
    whole = camera.rays_at([[10, 20], [80, 60]])[1]
    half = camera.rays_at([[5, 10], [40, 30]], WIDTH // 2, HEIGHT // 2)[1]
    np.testing.assert_allclose(half, whole, rtol=0, atol=1e-14)


def test_rows_are_those_of_the_picture():
    camera = Camera.from_intrinsics(K, POSE, SIZE, distortion=LENSES["all"])
    np.testing.assert_array_equal(camera.rays(rows=range(5, 9))[1], camera.rays()[1][5:9])


def test_no_distortion_is_a_pinhole():
    plain = Camera.from_intrinsics(K, POSE, SIZE)
    assert Camera.from_intrinsics(K, POSE, SIZE, distortion=np.zeros((1, 5))) == plain
    assert plain.lens.distortion is None
    tiny = Camera.from_intrinsics(K, POSE, SIZE, distortion=(1e-30, 0, 0, 0))
    np.testing.assert_allclose(tiny.rays()[1], plain.rays()[1], rtol=0, atol=1e-15)


@pytest.mark.parametrize("shape", [(5,), (1, 5), (5, 1), (4,), (1, 4)])
def test_coefficients_come_in_the_shapes_of_opencv(shape):
    values = np.array(LENSES["all"])
    values[4] = 0
    camera = Camera.from_intrinsics(K, POSE, SIZE, distortion=values[: max(shape)].reshape(shape))
    assert camera.lens.distortion == tuple(values)
    assert {camera} == {Camera.from_intrinsics(K, POSE, SIZE, distortion=tuple(values))}


@pytest.mark.parametrize(
    "distortion", [(0.1,), (0.1, 0, 0), np.zeros(8) + 0.1, (np.nan, 0, 0, 0), (np.inf, 0, 0, 0, 0), "abcd"]
)
def test_other_coefficients_are_refused(distortion):
    with pytest.raises(SceneError, match="k1, k2, p1, p2"):
        Camera.from_intrinsics(K, POSE, SIZE, distortion=distortion)


@pytest.mark.parametrize(
    "distortion",
    [(-1.5, 0, 0, 0), (-0.9, 0.1, 0, 0), (0, 0, 0.9, 0), (0.5, -3.0, 0, 0, 0), (1e30, 0, 0, -1e30), (-1e300, 0, 0, 0)],
)
def test_a_distortion_that_folds_inside_the_picture_is_refused(distortion):
    with pytest.raises(SceneError, match="no inverse in all of its picture"):
        Camera.from_intrinsics(K, POSE, SIZE, distortion=distortion)


def test_a_fold_outside_the_picture_is_none_of_its_business():
    # f(r) = r - r^3 / 2 has its fold at r = sqrt(2 / 3), where it is 0.544.
    distortion = (-0.5, 0, 0, 0)
    inside = Camera.from_intrinsics(
        [[100, 0, 50], [0, 100, 0.5], [0, 0, 1]], np.eye(4), (100, 1), distortion=distortion
    )
    assert np.isfinite(inside.rays()[1]).all()
    with pytest.raises(SceneError, match="no inverse"):
        Camera.from_intrinsics([[100, 0, 55], [0, 100, 0.5], [0, 0, 1]], np.eye(4), (110, 1), distortion=distortion)


def test_points_beyond_the_fold_are_not_seen():
    distortion = (-0.5, 0, 0, 0)
    camera = Camera.from_intrinsics([[100, 0, 30], [0, 100, 30], [0, 0, 1]], np.eye(4), (60, 60), distortion=distortion)
    pixels, depth = camera.project([[0.5, 0, 1], [1.2, 0, 1], [0.5, 0, -1]])
    assert pixels[0] == pytest.approx([30 + 100 * (0.5 - 0.5 * 0.125), 30])
    # By the formula alone the second one would be at 30 + 33.6.
    assert np.isnan(pixels[1:]).all()
    assert depth.tolist() == [1, 1, -1]


def test_a_lens_keeps_its_distortion_in_another_size():
    lens = Lens.from_matrix(K, SIZE, distortion=LENSES["all"])
    assert lens.resized(WIDTH * 2, HEIGHT * 2).distortion == LENSES["all"]


@pytest.mark.parametrize("seed", range(20))
def test_what_is_accepted_is_inverted_all_over_the_picture(seed):
    generator = np.random.default_rng([3, seed])
    distortion = generator.normal(size=5) * [0.4, 0.4, 0.05, 0.05, 0.4]
    try:
        camera = Camera.from_intrinsics(K, POSE, SIZE, distortion=distortion)
    except SceneError:
        return
    points = np.random.default_rng(seed).uniform(0, SIZE, (2000, 2))
    origins, directions = camera.rays_at(points)
    pixels, _ = camera.project(origins + 3 * directions)
    np.testing.assert_allclose(pixels, points, rtol=0, atol=1e-6)
