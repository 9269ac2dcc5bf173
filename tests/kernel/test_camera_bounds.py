"""The bounds of the rays through a rectangle of the picture hold all of them, for any point of the lens."""

import numpy as np
import pytest

from clbvh import Camera, Fisheye, Mesh, Orthographic, Panorama, View
from clbvh.rendering.kernel_view import make_kernel_view

WIDTH, HEIGHT = 64, 48
FLOAT3 = (np.float32, (3,))
RECTANGLES = 400

MESH = Mesh.from_arrays([[-1, -1, -1], [1, 1, 1], [1, -1, 0]], [[0, 1, 2]])
FRAME = {"eye": (3, 2, 5), "look_at": (0.5, -1, 0), "up": (0.1, 1, 0.2)}
LENS = [[70.0, 3, 20.0], [0, 66.0, 40.0], [0, 0, 1]]
POSE = np.array([[0.36, 0.48, -0.8, 3], [-0.8, 0.6, 0, -2], [0.48, 0.64, 0.6, 1], [0, 0, 0, 1]])

BOUNDED = {
    "perspective": Camera(**FRAME),
    "wide": Camera(**FRAME, fov=150),
    "lens": Camera.from_intrinsics(LENS, POSE, (WIDTH, HEIGHT)),
    "opening": Camera(**FRAME, aperture=0.8, focus_distance=2.0),
    "opening-far": Camera(**FRAME, aperture=0.8, focus_distance=1e9),
    "orthographic": Camera(**FRAME, projection=Orthographic(3)),
    "orthographic-opening": Camera(**FRAME, projection=Orthographic(3), aperture=0.5, focus_distance=1.5),
}
UNBOUNDED = {
    "distorted": Camera.from_intrinsics(LENS, POSE, (WIDTH, HEIGHT), distortion=(0.1, 0.01, 0, 0.001)),
    "fisheye": Camera(**FRAME, projection=Fisheye()),
    "panorama": Camera(**FRAME, projection=Panorama()),
}


def view_of(camera):
    return make_kernel_view(View(up="y", width=WIDTH, height=HEIGHT), camera, MESH)


def random_rectangles(seed):
    """Rectangles of up to a quarter of the picture, some of them points, up to two pixels beyond its sides."""
    generator = np.random.default_rng([76, seed])
    middle = generator.uniform(-1.05, 1.05, (RECTANGLES, 2))
    half = generator.uniform(0, 0.25, (RECTANGLES, 2)) * generator.integers(0, 2, (RECTANGLES, 1))
    return np.concatenate((middle - half, middle + half), axis=1).astype(np.float32)


def bounds_of(run_lane_shell, layout, camera, rectangles):
    float8 = (np.float32, (8,))
    return run_lane_shell(layout, "bound_camera", [rectangles, view_of(camera)], [float8, float8, (np.int32, ())])


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", BOUNDED)
def test_all_rays_of_a_rectangle_are_within_its_bounds(run_lane_shell, run_shell, name, seed):
    camera, rectangles = BOUNDED[name], random_rectangles(seed)
    lower, upper, bounded = bounds_of(run_lane_shell, "bvh8", camera, rectangles)
    assert bounded.all()
    generator = np.random.default_rng([77, seed])
    forward = camera.axes()[2]
    for corner in (None, 0, 1, 2, 3):
        share = (
            generator.random((RECTANGLES, 2)) if corner is None else np.tile([corner & 1, corner >> 1], (RECTANGLES, 1))
        )
        film = (rectangles[:, :2] * (1 - share) + rectangles[:, 2:] * share).astype(np.float32)
        film = np.clip(film, rectangles[:, :2], rectangles[:, 2:])
        # Many points are on the rim of the lens.
        lens = generator.choice([0, 0.5, np.float32(1 - 2**-24), 0.3], (RECTANGLES, 2)).astype(np.float32)
        written = [*[FLOAT3] * 6, (np.int32, ())]
        rays = run_shell("take_camera_rays", [film, lens, view_of(camera)], written)
        origin, direction = rays[4].astype(float), rays[5].astype(float)
        # Bounds are those of directions whose depth is 1.
        direction /= (direction @ forward)[:, None]
        assert (origin >= lower[:, :3]).all()
        assert (origin <= upper[:, :3]).all()
        slack = 8 * 2.0**-24 * np.abs(direction).max(axis=1, keepdims=True)
        assert (direction >= lower[:, 4:7] - slack).all()
        assert (direction <= upper[:, 4:7] + slack).all()


@pytest.mark.parametrize("name", BOUNDED)
def test_bounds_of_a_point_are_no_wider_than_its_lens(run_lane_shell, name):
    camera = BOUNDED[name]
    points = np.tile(random_rectangles(0)[:, :2], 2)
    lower, upper, _ = bounds_of(run_lane_shell, "bvh4", camera, np.ascontiguousarray(points))
    radius = camera.aperture / 2 * MESH.scale
    # The box of a disk is at most as wide as that of the square around it.
    assert (upper[:, :3] - lower[:, :3]).max() <= 2 * np.sqrt(2) * radius + 1e-4
    assert (upper[:, 4:7] - lower[:, 4:7]).max() <= 2 * np.sqrt(2) * radius / (camera.focus * MESH.scale) + 1e-4


@pytest.mark.parametrize("name", UNBOUNDED)
def test_curved_projections_have_no_bounds(run_lane_shell, name):
    _, _, bounded = bounds_of(run_lane_shell, "bvh8", UNBOUNDED[name], random_rectangles(0))
    assert not bounded.any()
