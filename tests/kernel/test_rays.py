"""Rays and the cameras that send them, against float64 and the host's cameras; and bounds of the rays of a tile."""

import numpy as np
import pytest

from clbvh import Camera, Fisheye, Mesh, Orthographic, Panorama, View
from clbvh.rendering.kernel_view import make_kernel_view

from ..rays import AXES
from .programs import make_rays

pytestmark = pytest.mark.on_both

WIDTH, HEIGHT = 90, 60
ROUNDING = 2.0**-24
POINTS = 2000

# OpenCL lets a division be 2.5 units in the last place off.
DIVISION = 2.5 * 2.0**-23


def test_the_axis_and_the_shear_lay_the_direction_along_z(call):
    generator = np.random.default_rng(3)
    mixed = generator.normal(size=(500, 3)) * 10.0 ** generator.uniform(-6, 6, (500, 3))
    directions = np.concatenate((AXES, [[1, 1, 1], [0, 1, -1], [1, 0, 1], [-1, 1, 0]], mixed)).astype(np.float32)
    body = """
        const ray_t ray = unpack_ray(packed);
        axis = ray.axis; shear = ray.shear; permuted = permute_axes((float3)(1.0f, 2.0f, 3.0f), ray.axis);
    """
    outputs = "int axis, float3 shear, float3 permuted"
    axis, shear, permuted = call("rays/ray.cl", body, outputs, packed=make_rays([0, 0, 0], directions))
    assert (np.abs(directions).max(axis=1) == np.abs(directions[np.arange(len(axis)), axis])).all()
    np.testing.assert_array_equal(permuted, np.array([[2, 3, 1], [3, 1, 2], [1, 2, 3]])[axis])
    x, y, z = np.take_along_axis(directions.astype(float), permuted.astype(int) - 1, axis=1).T
    np.testing.assert_allclose(shear, np.stack((x / z, y / z, 1 / z), axis=1), rtol=DIVISION, atol=0)


# Half as large as the device's own coordinates.
MESH = Mesh.from_arrays([[-1, -1, -1], [1, 1, 1], [1, -1, 0]], [[0, 1, 2]])
FRAME = {"eye": (3, 2, 5), "look_at": (0.5, -1, 0), "up": (0.1, 1, 0.2)}
LENS = [[82.0, 1.5, 41.0], [0, 80.0, 33.0], [0, 0, 1]]
POSE = np.array([[0.36, 0.48, -0.8, 3], [-0.8, 0.6, 0, -2], [0.48, 0.64, 0.6, 1], [0, 0, 0, 1]])


def lens_camera(**options):
    return Camera.from_intrinsics(LENS, POSE, (WIDTH, HEIGHT), **options)


CAMERAS = {
    "perspective": Camera(**FRAME, fov=50),
    "lens": lens_camera(),
    "orthographic": Camera(**FRAME, projection=Orthographic(3.5)),
    "barrel": lens_camera(distortion=(-0.25, 0.06, 0.004, -0.003, -0.01)),
    "pincushion": lens_camera(distortion=(0.3, 0.1, -0.002, 0.006)),
    "fisheye-180": Camera(**FRAME, projection=Fisheye(180)),
    "fisheye-360": Camera(**FRAME, projection=Fisheye(360)),
    "panorama": Camera(**FRAME, projection=Panorama()),
}

# Of the direction, in roundings: float32 steps of the inverse distortion and the polynomials of sine and cosine.
ROUNDINGS = {"barrel": 40, "pincushion": 40, "fisheye-180": 16, "fisheye-360": 16, "panorama": 16}

FOCUSED = {
    "perspective": Camera(**FRAME, fov=50, aperture=0.6, focus_distance=3.0),
    "look-at": Camera(**FRAME, fov=50, aperture=0.6),
    "barrel": lens_camera(distortion=(-0.25, 0.06, 0.004, -0.003), aperture=0.6, focus_distance=3.0),
    "orthographic": Camera(**FRAME, projection=Orthographic(3.5), aperture=0.6, focus_distance=2.0),
}


def view_of(camera):
    return {"view": make_kernel_view(View(up="y", width=WIDTH, height=HEIGHT), camera, MESH)}


def take(call, camera, film, lens):
    """Rays of points of picture and lens in the scene's coordinates: pairs, then in float32; and which are seen."""
    body = """
        seen = camera_ray(view, film, lens, &origin, &origin_low, &direction, &direction_low);
        camera_ray(view, film, lens, &single_origin, 0, &single_direction, 0);
    """
    outputs = "float3 origin, float3 origin_low, float3 direction, float3 direction_low, float3 single_origin, "
    outputs += "float3 single_direction, int seen"
    tables = view_of(camera)
    *found, seen = call("rays/camera.cl", body, outputs, film=film, lens=lens, tables=tables)
    origin, origin_low, direction, direction_low, single_origin, single_direction = np.float64(found)
    pair = (origin + origin_low) / MESH.scale, direction + direction_low
    return *pair, single_origin / MESH.scale, single_direction, seen == 1


def random_points(seed):
    """Points of the picture, among them its corners, and of the lens."""
    generator = np.random.default_rng([74, seed])
    film = generator.uniform(-1, 1, (POINTS, 2)).astype(np.float32)
    film[:5] = [[0, 0], [1, 1], [-1, 1], [1, -1], [-1, -1]]
    return film, generator.random((POINTS, 2), np.float32)


def host_rays(camera, film):
    pixels = (film.astype(float) * [1, -1] + 1) / 2 * [WIDTH, HEIGHT]
    return camera.rays_at(pixels, WIDTH, HEIGHT)


def close(found, expected, error):
    np.testing.assert_allclose(found, expected, rtol=0, atol=error)


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_are_those_of_the_host(call, name):
    camera, (film, _) = CAMERAS[name], random_points(0)
    origin, direction, single_origin, single_direction, seen = take(call, camera, film, [[0.5, 0.5]])
    origins, directions = host_rays(camera, film)
    slack = ROUNDINGS.get(name, 8) * ROUNDING
    close(direction[seen], directions[seen], slack)
    close(single_direction[seen], directions[seen], slack + 8 * ROUNDING)
    close(origin, origins, 8 * ROUNDING)
    close(single_origin, origins, 16 * ROUNDING * 6)
    # Rays of points that nothing is seen at, outside a fisheye's circle, are rays all the same.
    close(np.linalg.norm(direction, axis=1), 1, 4 * ROUNDING)
    close(np.linalg.norm(single_direction, axis=1), 1, 4 * ROUNDING)
    radius = np.hypot(film[:, 0] * WIDTH / HEIGHT, film[:, 1])
    np.testing.assert_array_equal(seen, (radius <= 1) | ("fisheye" not in name))
    if "fisheye" in name:
        angle = np.radians(camera.projection.angle) / 2 * radius[seen]
        close((direction @ camera.axes()[2])[seen], np.cos(angle), 1e-6)


@pytest.mark.parametrize("name", FOCUSED)
def test_rays_from_all_of_the_lens_meet_in_the_plane_of_focus(call, name):
    camera, (film, lens) = FOCUSED[name], random_points(1)
    origins, directions = host_rays(camera, film)
    forward = camera.axes()[2]
    origin, direction, *_ = take(call, camera, film, [[0.5, 0.5]])
    close(origin, origins, 8 * ROUNDING)
    close(direction, directions, 40 * ROUNDING)

    def reach(origin, direction):
        return origin + direction * (camera.focus / (direction @ forward))[:, None]

    origin, direction, single_origin, single_direction, _ = take(call, camera, film, lens)
    close(reach(origin, direction), reach(origins, directions), 1e-5)
    close(reach(single_origin, single_direction), reach(origins, directions), 2e-5)
    # They begin on a disk around the point where the ray of the middle begins, and all over it.
    assert np.abs((origin - origins) @ forward).max() < 1e-6
    radius = np.linalg.norm(origin - origins, axis=1) / (camera.aperture / 2)
    assert radius.max() < 1 + 1e-6
    assert abs(np.mean(radius < np.sqrt(0.5)) - 0.5) < 0.05


BOUNDED = {
    **{name: CAMERAS[name] for name in ("perspective", "lens", "orthographic")},
    "wide": Camera(**FRAME, fov=150),
    "opening": Camera(**FRAME, aperture=0.8, focus_distance=2.0),
    "opening-far": Camera(**FRAME, aperture=0.8, focus_distance=1e9),
    "orthographic-opening": FOCUSED["orthographic"],
}


def bound(call, camera, rectangles):
    """Bounds of origins and directions of the rays of all rectangles: lower, upper, and whether there are any."""
    body = """
        ray_bounds_t bounds = empty_bounds();
        bounded = bound_camera_rays(view, rectangle.lo, rectangle.hi, &bounds);
        lower = bounds.lower;
        upper = bounds.upper;
    """
    includes, outputs = "traversal/traverse.cl rays/camera_bounds.cl", "float8 lower, float8 upper, int bounded"
    return call(includes, body, outputs, rectangle=rectangles, tables=view_of(camera), layout="bvh8")


def random_rectangles():
    """Rectangles of up to a quarter of the picture, some of them points, up to two pixels beyond its sides."""
    generator = np.random.default_rng(76)
    middle = generator.uniform(-1.05, 1.05, (POINTS, 2))
    half = generator.uniform(0, 0.25, (POINTS, 2)) * generator.integers(0, 2, (POINTS, 1))
    return np.concatenate((middle - half, middle + half), axis=1).astype(np.float32)


@pytest.mark.parametrize("name", BOUNDED)
def test_all_rays_of_a_rectangle_are_within_its_bounds(call, name):
    camera, rectangles = BOUNDED[name], random_rectangles()
    lower, upper, bounded = bound(call, camera, rectangles)
    assert bounded.all()
    generator = np.random.default_rng(77)
    begin, end = rectangles[:, :2], rectangles[:, 2:]
    for share in (generator.random((POINTS, 2)), *np.ndindex(2, 2)):
        film = np.clip((begin * (1 - np.array(share)) + end * share).astype(np.float32), begin, end)
        # Many points are on the rim of the lens.
        lens = generator.choice([0, 0.5, np.float32(1 - 2**-24), 0.3], (POINTS, 2))
        _, _, origin, direction, _ = take(call, camera, film, lens)
        origin *= MESH.scale
        # Bounds are those of directions whose depth is 1.
        direction /= (direction @ camera.axes()[2])[:, None]
        slack = 8 * ROUNDING * np.abs(direction).max(axis=1, keepdims=True)
        assert ((lower[:, :3] <= origin) & (origin <= upper[:, :3])).all()
        assert ((lower[:, 4:7] - slack <= direction) & (direction <= upper[:, 4:7] + slack)).all()
    # Those of a point are no wider than its lens: the box of a disk is at most that of the square around it.
    lower, upper, _ = bound(call, camera, np.tile(begin, 2))
    width = 2 * np.sqrt(2) * camera.aperture / 2
    assert (upper[:, :3] - lower[:, :3]).max() <= width * MESH.scale + 1e-4
    assert (upper[:, 4:7] - lower[:, 4:7]).max() <= width / camera.focus + 1e-4
    # Curved projections have no bounds.
    assert not any(
        bound(call, CAMERAS[curved], rectangles)[2].any() for curved in ("barrel", "fisheye-180", "panorama")
    )
