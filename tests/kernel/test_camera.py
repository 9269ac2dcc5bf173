"""Primary rays against float64: through the centres of pixels, row 0 at the top."""

import numpy as np
import pytest

from clbvh import Camera, Mesh, View
from clbvh.rendering.kernel_view import make_kernel_view
from clbvh.structs import VIEW

WIDTH, HEIGHT = 203, 117
FLOAT3 = (np.float32, (3,))
ROUNDING = 2.0**-24

# The bound on which the beams of tiles rely, see DIRECTION_SLACK in cl/rays/camera_bounds.cl.
DIRECTION_ROUNDINGS = 16


def make_view(generator):
    """A view whose camera is anywhere and of any shape; `right` and `up` need not be perpendicular."""
    view = np.zeros(1, VIEW)
    view["eye"] = generator.normal(size=3) * 10.0 ** generator.uniform(-3, 3)
    forward = generator.normal(size=3)
    view["forward"] = forward / np.linalg.norm(forward)
    view["right"], view["up"] = generator.normal(size=(2, 3)) * 10.0 ** generator.uniform(-2, 1, (2, 1))
    view["width"], view["height"] = WIDTH, HEIGHT
    return view


@pytest.fixture(scope="module")
def take(run_shell):
    """A function from a view and pixels, (n, 2), to the arrays of `take_pixels.cl`."""

    def run(view, pixels):
        pixels = np.ascontiguousarray(pixels, np.int32)
        return run_shell("take_pixels", [pixels, view], [FLOAT3, FLOAT3, FLOAT3])

    return run


def all_pixels():
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack((columns.ravel(), rows.ravel()), axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_rays_go_through_the_centres_of_pixels(take, seed):
    view = make_view(np.random.default_rng([70, seed]))
    pixels = all_pixels()
    directions, origins, ray_directions = take(view, pixels)

    forward, right, up = (view[name][0].astype(np.float64) for name in ("forward", "right", "up"))
    x = (2 * pixels[:, :1] + 1) / WIDTH - 1
    y = 1 - (2 * pixels[:, 1:] + 1) / HEIGHT
    expected = forward + x * right + y * up
    slack = DIRECTION_ROUNDINGS * ROUNDING * (np.abs(forward) + np.abs(right) + np.abs(up))
    assert (np.abs(directions - expected) <= slack).all()

    length = np.linalg.norm(directions.astype(np.float64), axis=1, keepdims=True)
    np.testing.assert_allclose(ray_directions, directions / length, rtol=0, atol=4 * ROUNDING)
    np.testing.assert_array_equal(origins, np.broadcast_to(view["eye"], origins.shape))


def test_rays_are_those_of_the_host_camera(take):
    camera = Camera((3.0, 2.0, 5.0), (0.5, -1.0, 0.0), fov=50.0)
    right, up, forward = camera.axes()
    half_height = np.tan(np.radians(camera.fov) / 2)
    view = np.zeros(1, VIEW)
    view["eye"], view["forward"] = camera.eye, forward
    view["right"], view["up"] = half_height * WIDTH / HEIGHT * right, half_height * up
    view["width"], view["height"] = WIDTH, HEIGHT
    _, origins, directions = take(view, all_pixels())
    expected_origins, expected = camera.rays(WIDTH, HEIGHT)
    np.testing.assert_array_equal(origins, expected_origins.reshape(-1, 3))
    np.testing.assert_allclose(directions, expected.reshape(-1, 3), rtol=0, atol=DIRECTION_ROUNDINGS * ROUNDING)


@pytest.mark.parametrize("seed", range(4))
def test_rays_of_a_lens_are_those_of_the_host_camera(take, seed):
    generator = np.random.default_rng([72, seed])
    focal = generator.uniform(20, 2000, 2)
    k = np.array([[focal[0], generator.normal() * 20, 0], [0, focal[1], 0], [0, 0, 1]])
    k[:2, 2] = generator.normal(size=2) * 300 + 100
    rotation, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = generator.integers(-4, 4, 3)
    camera = Camera.from_intrinsics(k, pose, (WIDTH, HEIGHT))
    mesh = Mesh.from_arrays([[-1, -1, -1], [1, 1, 1], [1, -1, 0]], [[0, 1, 2]])
    assert mesh.scale == 0.5
    view = make_kernel_view(View(up="y", width=WIDTH, height=HEIGHT), camera, mesh)
    _, origins, directions = take(view, all_pixels())
    expected_origins, expected = camera.rays()
    np.testing.assert_array_equal(origins, 0.5 * expected_origins.reshape(-1, 3))
    spanned = sum(np.abs(view[name][0].astype(float)) for name in ("forward", "right", "up")).max()
    # Every direction reaches depth 1 before it is normalized.
    slack = DIRECTION_ROUNDINGS * ROUNDING * (1 + spanned)
    np.testing.assert_allclose(directions, expected.reshape(-1, 3), rtol=0, atol=slack)


def test_row_0_is_the_top_and_column_0_is_left(take):
    view = np.zeros(1, VIEW)
    view["forward"], view["right"], view["up"] = [0, 0, -1], [1, 0, 0], [0, 1, 0]
    view["width"], view["height"] = 2, 2
    directions, *_ = take(view, [[0, 0], [1, 0], [0, 1], [1, 1]])
    assert directions.tolist() == [[-0.5, 0.5, -1], [0.5, 0.5, -1], [-0.5, -0.5, -1], [0.5, -0.5, -1]]
