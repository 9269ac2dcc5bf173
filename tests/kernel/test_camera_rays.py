"""The rays of all kinds of cameras against those of the host, through any point of the picture and of the lens."""

import numpy as np
import pytest

from clbvh import Camera, Fisheye, Mesh, Orthographic, Panorama, Scene
from clbvh.rendering.view import make_view

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
        view = make_view(Scene(MESH, width=WIDTH, height=HEIGHT), camera, MESH)
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
