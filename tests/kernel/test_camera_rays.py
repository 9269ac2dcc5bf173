"""The rays of all kinds of cameras against those of the host, through any point of the picture and of the lens."""

import numpy as np
import pytest

from clbvh import Camera, Fisheye, Mesh, Orthographic, Panorama, View
from clbvh.rendering.kernel_view import make_kernel_view

WIDTH, HEIGHT = 90, 60
FLOAT3 = (np.float32, (3,))
ROUNDING = 2.0**-24
POINTS = 2000

K = [[82.0, 1.5, 41.0], [0, 80.0, 33.0], [0, 0, 1]]
POSE = np.array([[0.36, 0.48, -0.8, 3], [-0.8, 0.6, 0, -2], [0.48, 0.64, 0.6, 1], [0, 0, 0, 1]])
FRAME = {"eye": (3, 2, 5), "look_at": (0.5, -1, 0), "up": (0.1, 1, 0.2)}

CAMERAS = {
    "perspective": Camera(**FRAME, fov=50),
    "lens": Camera.from_intrinsics(K, POSE, (WIDTH, HEIGHT)),
    "distorted-barrel": Camera.from_intrinsics(
        K, POSE, (WIDTH, HEIGHT), distortion=(-0.25, 0.06, 0.004, -0.003, -0.01)
    ),
    "distorted-pincushion": Camera.from_intrinsics(K, POSE, (WIDTH, HEIGHT), distortion=(0.3, 0.1, -0.002, 0.006)),
    "orthographic": Camera(**FRAME, projection=Orthographic(3.5)),
    "fisheye-180": Camera(**FRAME, projection=Fisheye(180)),
    "fisheye-360": Camera(**FRAME, projection=Fisheye(360)),
    "panorama": Camera(**FRAME, projection=Panorama()),
}

# Of the direction, in roundings: float32 steps of the inverse distortion and the polynomials of sine and cosine.
DIRECTION_SLACK = {
    "distorted-barrel": 40,
    "distorted-pincushion": 40,
    "fisheye-180": 16,
    "fisheye-360": 16,
    "panorama": 16,
}

MESH = Mesh.from_arrays([[-1, -1, -1], [1, 1, 1], [1, -1, 0]], [[0, 1, 2]])


@pytest.fixture(scope="module")
def take(run_shell):
    """A function from a camera and points of picture and lens to rays in the scene's coordinates, by name."""

    def run(camera, film, lens):
        view = make_kernel_view(View(up="y", width=WIDTH, height=HEIGHT), camera, MESH)
        written = [*[FLOAT3] * 6, (np.int32, ())]
        arrays = [np.ascontiguousarray(points, np.float32) for points in (film, lens)]
        origin, origin_low, direction, direction_low, single_origin, single_direction, seen = run_shell(
            "take_camera_rays", [*arrays, view], written
        )
        return {
            "origin": (origin.astype(float) + origin_low) / MESH.scale,
            "direction": direction.astype(float) + direction_low,
            "single_origin": single_origin / MESH.scale,
            "single_direction": single_direction.astype(float),
            "seen": seen.astype(bool),
        }

    return run


def random_points(seed):
    generator = np.random.default_rng([74, seed])
    film = generator.uniform(-1, 1, (POINTS, 2)).astype(np.float32)
    film[:5] = [[0, 0], [1, 1], [-1, 1], [1, -1], [-1, -1]]
    return film, generator.random((POINTS, 2), np.float32)


def host_rays(camera, film):
    pixels = (film.astype(float) * [1, -1] + 1) / 2 * [WIDTH, HEIGHT]
    return camera.rays_at(pixels, WIDTH, HEIGHT)


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_are_those_of_the_host(take, name):
    camera, (film, _) = CAMERAS[name], random_points(0)
    rays = take(camera, film, np.full_like(film, 0.5))
    origins, directions = host_rays(camera, film)
    slack = DIRECTION_SLACK.get(name, 8) * ROUNDING
    is_seen = rays["seen"]
    np.testing.assert_allclose(rays["direction"][is_seen], directions[is_seen], rtol=0, atol=slack)
    np.testing.assert_allclose(
        rays["single_direction"][is_seen], directions[is_seen], rtol=0, atol=slack + 8 * ROUNDING
    )
    np.testing.assert_allclose(rays["origin"], origins, rtol=0, atol=8 * ROUNDING)
    np.testing.assert_allclose(rays["single_origin"], origins, rtol=0, atol=16 * ROUNDING * 6)
    np.testing.assert_allclose(np.linalg.norm(rays["direction"], axis=1), 1, rtol=0, atol=4 * ROUNDING)


FOCUSED = {
    "perspective": Camera(**FRAME, fov=50, aperture=0.6, focus_distance=3.0),
    "look-at": Camera(**FRAME, fov=50, aperture=0.6),
    "distorted": Camera.from_intrinsics(
        K, POSE, (WIDTH, HEIGHT), distortion=(-0.25, 0.06, 0.004, -0.003), aperture=0.6, focus_distance=3.0
    ),
    "orthographic": Camera(**FRAME, projection=Orthographic(3.5), aperture=0.6, focus_distance=2.0),
}


@pytest.mark.parametrize("name", FOCUSED)
def test_rays_from_all_of_the_lens_meet_in_the_plane_of_focus(take, name):
    camera, (film, lens) = FOCUSED[name], random_points(1)
    rays = take(camera, film, lens)
    origins, directions = host_rays(camera, film)
    forward = camera.axes()[2]

    def reach(origin, direction, depth):
        return origin + direction * (depth / (direction @ forward))[:, None]

    expected = reach(origins, directions, camera.focus)
    np.testing.assert_allclose(reach(rays["origin"], rays["direction"], camera.focus), expected, rtol=0, atol=1e-5)
    single = reach(rays["single_origin"], rays["single_direction"], camera.focus)
    np.testing.assert_allclose(single, expected, rtol=0, atol=2e-5)

    # They begin on a disk around the point where the ray of the middle begins, and all over it.
    offset = rays["origin"] - origins
    assert np.abs(offset @ forward).max() < 1e-6
    radius = np.linalg.norm(offset, axis=1) / (camera.aperture / 2)
    assert radius.max() < 1 + 1e-6
    assert abs(np.mean(radius < np.sqrt(0.5)) - 0.5) < 0.05


@pytest.mark.parametrize("name", FOCUSED)
def test_the_middle_of_the_lens_sends_the_rays_of_the_host(take, name):
    camera, (film, _) = FOCUSED[name], random_points(2)
    rays = take(camera, film, np.full_like(film, 0.5))
    origins, directions = host_rays(camera, film)
    np.testing.assert_allclose(rays["origin"], origins, rtol=0, atol=8 * ROUNDING)
    np.testing.assert_allclose(rays["direction"], directions, rtol=0, atol=40 * ROUNDING)


def test_a_far_focus_has_parallel_rays(take):
    camera = Camera(**FRAME, aperture=0.6, focus_distance=1e9)
    film, lens = random_points(3)
    directions = take(camera, film, lens)["direction"]
    np.testing.assert_allclose(directions, host_rays(camera, film)[1], rtol=0, atol=8 * ROUNDING)


@pytest.mark.parametrize("name", ["fisheye-180", "fisheye-360"])
def test_a_fisheye_sees_the_inside_of_its_circle(take, name):
    camera, (film, lens) = CAMERAS[name], random_points(4)
    radius = np.hypot(film[:, 0] * WIDTH / HEIGHT, film[:, 1])
    rays = take(camera, film, lens)
    np.testing.assert_array_equal(rays["seen"], radius <= 1)
    # Rays outside are rays all the same.
    np.testing.assert_allclose(np.linalg.norm(rays["single_direction"], axis=1), 1, rtol=0, atol=4 * ROUNDING)
    cosines = rays["direction"] @ camera.axes()[2]
    angle = np.radians(camera.projection.angle) / 2 * radius
    np.testing.assert_allclose(cosines[radius <= 1], np.cos(angle)[radius <= 1], rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", sorted(set(CAMERAS) - {"fisheye-180", "fisheye-360"}))
def test_other_cameras_see_something_everywhere(take, name):
    film, lens = random_points(5)
    assert take(CAMERAS[name], film, lens)["seen"].all()
