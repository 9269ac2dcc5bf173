"""Cameras of numbers, sizes and arguments that nobody expects, but that users have."""

import math
import warnings

import numpy as np
import pytest

from clbvh import Camera, Lens
from clbvh.errors import SceneError

CAMERA = Camera((1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
K = [[500.0, 1.0, 310.0], [0.0, 510.0, 250.0], [0.0, 0.0, 1.0]]
TOO_LONG = 10**400  # an integer that float64 cannot hold


@pytest.fixture(autouse=True)
def _no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


class TestOrbit:
    def test_the_point_may_be_an_array(self):
        camera = Camera.from_intrinsics(K, np.eye(4), (640, 480))
        assert camera.orbit(90, about=np.array([0.0, 0.0, 1.0])) == camera.orbit(90, about=(0, 0, 1))
        assert CAMERA.orbit(90, about=np.zeros(3)) == CAMERA.orbit(90)
        assert CAMERA.orbit(90, about=[0, 0, 0], axis=np.array([0, 1, 0])) == CAMERA.orbit(90)

    @pytest.mark.parametrize("turns", [1, -1, 10**9, 2.0**1000])
    def test_whole_turns_change_nothing(self, turns):
        assert CAMERA.orbit(360 * turns) == CAMERA
        assert CAMERA.orbit(360 * turns + 0.0) == CAMERA

    def test_many_turns_and_a_part_of_one(self):
        assert CAMERA.orbit(360e9 + 90) == CAMERA.orbit(90)

    @pytest.mark.parametrize(
        "degrees", [pytest.param(TOO_LONG, id="10**400"), math.inf, np.float32(np.inf), math.nan, True, "90", None]
    )
    def test_no_number_of_degrees(self, degrees):
        with pytest.raises(SceneError, match=r"degrees .* must be a finite number"):
            CAMERA.orbit(degrees)


class TestRows:
    def test_no_rows_are_none(self):
        origins, directions = CAMERA.rays(8, 6, range(0))
        assert origins.shape == directions.shape == (0, 8, 3)

    def test_some_rows_in_any_order(self):
        directions = CAMERA.rays(8, 6)[1]
        np.testing.assert_array_equal(CAMERA.rays(8, 6, range(5, -1, -2))[1], directions[5::-2])

    @pytest.mark.parametrize("rows", [range(4, 7), range(-1, 2), range(2, -2, -1), [1, 2], 3, slice(0, 2)])
    def test_rows_that_the_picture_does_not_have(self, rows):
        with pytest.raises(SceneError, match="the rows of a picture of 6 rows"):
            CAMERA.rays(8, 6, rows)


class TestNumbers:
    @pytest.mark.parametrize("length", [5e-324, 1e-310, 1e-200, 1.0, 1e200, 1.7e308])
    def test_up_may_have_any_length(self, length):
        camera = Camera((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), up=(0.0, length, 0.0))
        for axis, expected in zip(camera.axes(), CAMERA.axes(), strict=True):
            np.testing.assert_allclose(axis, expected, atol=1e-15)

    def test_points_farther_apart_than_float64_can_hold(self):
        with pytest.raises(SceneError, match="farther apart"):
            Camera((1e308, 0.0, 0.0), (-1e308, 0.0, 0.0))

    def test_a_camera_has_numbers_of_python(self):
        camera = Camera((0, 0, 1), (0, 0, 0), fov=np.float32(30))
        assert type(camera.fov) is float
        lens = Lens(np.float32(500), np.int16(510), 310, np.float64(250), 0, np.uint16(640), np.uint16(480))
        assert {type(value) for value in vars(lens).values() if value is not None} == {int, float}

    def test_sizes_of_a_short_type_do_not_overflow(self):
        short, plain = (Camera.from_intrinsics(K, np.eye(4), size) for size in (np.uint16([640, 480]), (640, 480)))
        assert short == plain
        for width, height in [(320, None), (None, 240), (320, 240), (200, 150)]:
            as_short = [None if side is None else np.uint8(side) if side < 256 else np.uint16(side)
                        for side in (width, height)]  # fmt: skip
            np.testing.assert_array_equal(short.rays(*as_short)[1], plain.rays(width, height)[1])
            np.testing.assert_array_equal(short.intrinsics(*as_short), plain.intrinsics(width, height))

    @pytest.mark.parametrize("fov", [True, pytest.param(TOO_LONG, id="10**400")])
    def test_no_field_of_view(self, fov):
        with pytest.raises(SceneError, match="fov must be a number above 0 and below 180"):
            Camera((0, 0, 1), (0, 0, 0), fov=fov)

    def test_sides_beyond_all_pictures(self):
        with pytest.raises(SceneError, match="width of a camera's picture must be a whole number from 1"):
            Camera.from_intrinsics(K, np.eye(4), (TOO_LONG, 480))
        with pytest.raises(SceneError, match="fx must be a finite number"):
            Lens(TOO_LONG, 1, 0, 0, 0, 640, 480)
