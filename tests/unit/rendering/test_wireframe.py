"""Wireframes: lines against the projected edges, in all projections, shadings, bands and scenes."""

import dataclasses

import numpy as np
import pytest

import clbvh
from clbvh import Wireframe
from clbvh.geometry.appearance.srgb import linear_to_srgb

WIDTH, HEIGHT = 96, 64
FRAME = {"eye": (0.5, 0.4, 3), "look_at": (0, 0, 0), "up": (0.1, 1, 0.2)}
K = [[82.0, 1.5, 47.0], [0, 80.0, 33.0], [0, 0, 1]]
POSE = np.linalg.inv(np.array([[1, 0, 0, 0.1], [0, -1, 0, 0.05], [0, 0, -1, 2.6], [0, 0, 0, 1]]))

# Cameras, and what the curvature of edges within a pixel of a round picture adds to the error of a share.
CAMERAS = {
    "perspective": (clbvh.Camera(**FRAME, fov=50), 0.005),
    "grazing": (clbvh.Camera((2.2, 0.3, 1.4), (0, 0, 0), fov=40), 0.005),
    "narrow": (clbvh.Camera((300, 200, 3000), (0, 0, 0), fov=0.05), 0.005),
    "distorted": (
        clbvh.Camera.from_intrinsics(K, POSE, (WIDTH, HEIGHT), distortion=(-0.25, 0.06, 0.004, -0.003)), 0.02,
    ),
    "orthographic": (clbvh.Camera(**FRAME, projection=clbvh.Orthographic(2.6)), 0.005),
    "fisheye": (clbvh.Camera((0.2, 0.1, 0.9), (0, 0, 0), projection=clbvh.Fisheye(190)), 0.03),
    "panorama": (clbvh.Camera((0.2, 0.1, 0.6), (0, 0, 0.1), projection=clbvh.Panorama()), 0.05),
}  # fmt: skip
SMALL = ("fisheye", "panorama", "grazing")  # the triangles are too small there for wide lines

CORNERS = np.array([[-1, -0.9, 0.1], [1.1, -0.7, -0.2], [0.9, 1, 0.2], [-0.8, 0.8, -0.1]])
SQUARE = clbvh.Mesh.from_arrays(CORNERS, [[0, 1, 2], [0, 2, 3]])
EDGES = [(0, 1), (1, 2), (2, 0), (2, 3), (3, 0)]
ROUNDING = 2 / 255  # two colours of 8 bits


def draw_share(source, wireframe=Wireframe(), **view):  # noqa: B008 - a value
    """The share of each pixel that lines cover, (h, w), and the picture of white lines."""
    view = {"width": WIDTH, "height": HEIGHT, "shading": "normal"} | view
    with clbvh.Renderer(source) as renderer:
        black, white = (
            renderer.render(wireframe=dataclasses.replace(wireframe, colour=(grey,) * 3), **view) for grey in (0, 1)
        )
    return (white.rgb.astype(int) - black.rgb).mean(axis=2) / 255, white


def find_distance(camera, pixels):
    """The distance of pixels, (n, 2), to the nearest of the projected edges, each a chain of many straight pieces."""
    least = np.full(len(pixels), np.inf)
    steps = np.linspace(0, 1, 400)[:, None]
    for begin, end in EDGES:
        places, _ = camera.project(CORNERS[begin] + steps * (CORNERS[end] - CORNERS[begin]), WIDTH, HEIGHT)
        places = places[np.isfinite(places).all(axis=1)]
        first, way = places[:-1], np.diff(places, axis=0)
        # Over the edge of a panorama there is no piece.
        near = np.abs(way).max(axis=1) < WIDTH / 2
        first, way = first[near], way[near]
        towards = pixels[:, None] - first
        along = np.clip((towards * way).sum(axis=2) / (way**2).sum(axis=1), 0, 1)
        least = np.minimum(least, np.linalg.norm(towards - along[..., None] * way, axis=2).min(axis=1))
    return least


@pytest.mark.parametrize("name", CAMERAS)
def test_lines_have_their_width_around_the_projected_edges(name):
    camera, curvature = CAMERAS[name]
    for width in (0.4, 1, 3)[: 2 if name in SMALL else 3]:
        obtained, picture = draw_share(SQUARE, Wireframe(width), camera=camera)
        rows, columns = np.nonzero(picture.hits.is_hit)
        assert len(rows) > 200
        distance = find_distance(camera, np.stack((columns + 0.5, rows + 0.5), axis=1))
        expected = np.clip(0.5 * (width + 1) - distance, 0, min(width, 1))
        assert (expected > 0).sum() > 20
        np.testing.assert_allclose(obtained[rows, columns], expected, rtol=0, atol=ROUNDING + curvature)
        assert not obtained[~picture.hits.is_hit].any()


def test_triangles_as_small_as_pixels_have_no_lines():
    ball = clbvh.make_shape("icosphere", triangles=20_480)
    means = []
    for height in (20, 80, 160, 320, 640):
        share, picture = draw_share(ball, width=height, height=height)
        means.append(share[picture.hits.is_hit].mean())
    assert means[0] == 0
    assert 0 < means[1] < 0.1
    # Between no lines and lines of a pixel around large triangles, which are few again, nothing turns black.
    assert 0.2 < max(means[2:]) < 0.4


def test_instances_have_lines_and_spheres_have_none():
    ball, turned = clbvh.make_shape("icosphere", triangles=80), clbvh.Transform((-1, 1.2, 0.7), (10, 20, 30))
    centres = np.random.default_rng(85).uniform((1.6, -0.6, -0.6), (2.8, 0.6, 0.6), (200, 3))
    scene = clbvh.Scene()
    scene.place(scene.add(ball), turned)
    scene.place(scene.add(clbvh.Spheres(centres, 0.3)))
    camera = clbvh.Camera((1, 0.5, 6), (1, 0, 0))
    share, picture = draw_share(scene, camera=camera)
    assert not share[picture.hits.instance_id == 1].any()
    placed = clbvh.Mesh.from_arrays(ball.vertices @ turned.matrix[:3, :3].T, ball.faces)
    expected, _ = draw_share(placed, camera=camera)
    is_mesh = picture.hits.instance_id == 0
    assert expected[is_mesh].max() > 0.9
    np.testing.assert_allclose(share[is_mesh], expected[is_mesh], rtol=0, atol=2 * ROUNDING)


def test_neither_light_nor_exposure_changes_the_colour():
    # The middle of the diagonal, across the picture.
    camera = clbvh.Camera((0.05, 0.05, 0.4), (-0.05, 0.05, 0.15))
    wide = Wireframe(8, (1.0, 0.214, 0.05))
    view = {"camera": camera, "wireframe": wide, "width": 64, "height": 64, "exposure": -1.5}
    for shading in ({"shading": "lambert"}, {"tone_curve": "linear"}, {"tone_curve": "filmic"}):
        rgb = clbvh.render(SQUARE, **shading, **view).rgb
        np.testing.assert_allclose(rgb[32, 32], linear_to_srgb(wide.colour) * 255, atol=1)
