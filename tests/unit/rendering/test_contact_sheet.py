"""Contact sheets: the views in their places, at one scale, with captions."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.choices import STANDARD_VIEWS
from clbvh.rendering.image_files import GROUND, draw_text, width_of
from clbvh.rendering.series import _join, _round_down

BOX = ([[0, 0, 0], [4, 0, 0], [0, 2, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
WIDTH, HEIGHT = 80, 60


@pytest.fixture(scope="module")
def sheet():
    return clbvh.contact_sheet(BOX, width=WIDTH, height=HEIGHT, shading="lambert")


def test_the_pictures_are_in_their_places(sheet):
    strip = sheet.rgb.shape[0] // 2 - HEIGHT
    assert sheet.rgb.shape == (2 * (HEIGHT + strip), 4 * WIDTH, 3)
    assert tuple(sheet.pictures) == STANDARD_VIEWS
    for number, picture in enumerate(sheet.pictures.values()):
        row, column = divmod(number, 4)
        top, left = row * (HEIGHT + strip), column * WIDTH
        np.testing.assert_array_equal(sheet.rgb[top : top + HEIGHT, left : left + WIDTH], picture.rgb)
        caption = sheet.rgb[top + HEIGHT : top + HEIGHT + strip, left : left + WIDTH]
        assert (caption[:, 0] == GROUND).all()
        assert caption.max() > 150


def test_all_views_have_one_scale(sheet):
    extents = {}
    for view, picture in sheet.pictures.items():
        rows, columns = np.nonzero(picture.alpha)
        extents[view] = np.array([np.ptp(columns) + 1, np.ptp(rows) + 1]) * sheet.pixel_size
    for view, size in {"front": (4, 2), "back": (4, 2), "left": (1, 2), "top": (4, 1), "bottom": (4, 1)}.items():
        np.testing.assert_allclose(extents[view], size, atol=2.5 * sheet.pixel_size)
    assert len({picture.camera.projection for picture in sheet.pictures.values()}) == 1


def test_nothing_is_cut_off(sheet):
    for picture in sheet.pictures.values():
        alpha = picture.alpha
        assert not any(side.any() for side in (alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]))


def test_a_scene_with_an_eye_and_a_tree_are_taken():
    scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=80))
    view = clbvh.View(eye=(0, 0, 9), transparent=True)
    assert clbvh.contact_sheet(scene, view, width=20, height=20, shading="lambert").rgb.shape[1:] == (80, 3)
    tree = clbvh.build(clbvh.make_shape("icosphere", triangles=80))
    assert clbvh.contact_sheet(tree, width=20, height=20, shading="lambert").rgb.shape[1:] == (80, 3)


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_any_size(scale):
    sheet = clbvh.contact_sheet((np.array(BOX[0]) * scale, BOX[1]), width=64, height=48, shading="lambert")
    plain = clbvh.contact_sheet(BOX, width=64, height=48, shading="lambert")
    np.testing.assert_array_equal(sheet.pictures["front"].alpha, plain.pictures["front"].alpha)


def test_up_is_that_of_the_call():
    sheet = clbvh.contact_sheet(BOX, width=40, height=30, shading="lambert", up=(0, 0, 1))
    assert sheet.pictures["top"].camera.axes()[2].tolist() == [0, 0, -1]


def test_the_ground_of_a_view_from_the_top_lies_below():
    ball = clbvh.make_shape("icosphere", triangles=320)
    bare, grounded = (clbvh.contact_sheet(ball, width=40, height=40, ground=ground) for ground in (False, True))
    differs = [
        view for view in STANDARD_VIEWS if not np.array_equal(bare.pictures[view].rgb, grounded.pictures[view].rgb)
    ]
    assert "top" in differs
    assert "bottom" not in differs


def test_files(sheet, tmp_path):
    from PIL import Image

    sheet.save(tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        np.testing.assert_array_equal(np.asarray(image), sheet.rgb)
    assert sheet._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize("width", [0, 70_000, 1.5, True])
def test_wrong_sizes_are_refused(width):
    with pytest.raises(clbvh.SceneError, match="width"):
        clbvh.contact_sheet(BOX, width=width)


@pytest.mark.parametrize(
    ("length", "rounded"), [(1, 1), (1.99, 1), (2, 2), (4.9, 2), (0.099, 0.05), (7e20, 5e20), (3e-31, 2e-31)]
)
def test_round_lengths(length, rounded):
    assert _round_down(length) == pytest.approx(rounded)


def test_sizes():
    assert _join(1.23456, 1e-30) == "1.235 x 1e-30"


@pytest.mark.parametrize("scale", [1, 3])
def test_text_is_as_wide_as_it_says(scale):
    pixels = np.full((20 * scale, 200 * scale, 3), GROUND, np.uint8)
    draw_text(pixels, "Top x 4.5", 4 * scale, 100 * scale, scale)
    rows, columns = np.nonzero((pixels != GROUND).any(axis=-1))
    assert abs(np.ptp(columns) - width_of("Top x 4.5", scale)) <= 2 * scale
    assert 6 * scale <= np.ptp(rows) <= 10 * scale
    assert rows.min() >= 3 * scale


def test_text_that_does_not_fit_is_cut_off():
    pixels = np.full((4, 10, 3), GROUND, np.uint8)
    draw_text(pixels, "a long text", 1, 5, 2)
    assert pixels.shape == (4, 10, 3)
