"""Spheres: checks, and local coordinates."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from clbvh import Spheres
from clbvh.errors import MeshError

CENTRES = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 2.0, 1.0]]


def test_centres_and_radii_are_kept_and_once_more_around_zero_and_about_1_in_size():
    spheres = Spheres(CENTRES, [1, 2, 0.5], name="atoms")
    assert (spheres.centres.tolist(), spheres.radii.tolist()) == (CENTRES, [1, 2, 0.5])
    # From -1 to 6, from -2 to 2.5, and from -2 to 2.
    assert (spheres.origin.tolist(), spheres.scale) == ([2.5, 0.25, 0], 0.25)
    assert (spheres.local_centres * 4).tolist() == [[-2.5, -0.25, 0], [1.5, -0.25, 0], [-2.5, 1.75, 1]]
    assert (spheres.local_radii * 4).tolist() == [1, 2, 0.5]
    assert (spheres.centres.dtype, spheres.radii.dtype, spheres.origin.dtype) == (np.float64,) * 3
    assert (spheres.local_centres.dtype, spheres.local_radii.dtype) == (np.float32, np.float32)
    assert (spheres.to_local(CENTRES) == spheres.local_centres).all()
    assert (spheres.prim_count, spheres.is_watertight, spheres.name) == (3, True, "atoms")
    assert (spheres.local_box * 4).tolist() == [[-3.5, -2.25, -2], [3.5, 2.25, 2]]


@pytest.mark.parametrize("exponent", [-495, -149, -52, -1, 0, 1, 23, 300, 490])
def test_local_coordinates_have_the_same_bits_in_every_unit(exponent):
    rng = np.random.default_rng(0)
    centres, radii = rng.normal(size=(50, 3)), rng.uniform(0.1, 1, 50)
    spheres, scaled = (Spheres(centres * unit, radii * unit) for unit in (1, 2.0**exponent))
    assert scaled.local_centres.tobytes() == spheres.local_centres.tobytes()
    assert scaled.local_radii.tobytes() == spheres.local_radii.tobytes()
    assert scaled.scale == spheres.scale * 2.0**-exponent
    assert scaled.fingerprint == spheres.fingerprint
    assert 0.49 <= np.abs(spheres.local_box).max() <= 1


@pytest.mark.parametrize("radius", [1e-30, 1e-9, 1.0, 1e30])
@pytest.mark.parametrize("place", [0.0, 1.0, 5e6, -1e30])
def test_a_single_sphere_of_any_size_anywhere_has_a_radius_of_about_1(radius, place):
    spheres = Spheres([[place, 0, -place]], radius)
    assert 0.49 <= spheres.local_radii[0] <= 1
    assert np.abs(spheres.local_centres[0]).max() <= 1
    assert spheres.local_radii[0] == np.float32(radius * spheres.scale)


def test_the_smallest_spheres_keep_a_radius_beside_the_largest():
    spheres = Spheres([[0, 0, 0], [1, 0, 0]], [1e30, 1e-30])
    assert (spheres.local_radii >= np.finfo(np.float32).tiny).all()
    assert spheres.radii.tolist() == [1e30, 1e-30]


def test_the_outermost_sphere_leaves_room_for_rounding():
    # The box around all is as large as a power of two, which would become the end of local coordinates.
    spheres = Spheres([[-3, 0, 0], [3, 0, 0]], np.nextafter(1, 0))
    assert spheres.scale == 0.125


def test_one_radius_is_the_radius_of_all():
    spheres = Spheres(np.zeros((3, 3), np.int32), 2)
    assert spheres.radii.tolist() == [2, 2, 2]


def test_arrays_of_the_caller_are_not_changed_nor_kept():
    centres, radii = np.array(CENTRES), np.array([1.0, 2, 3])
    spheres = Spheres(centres, radii)
    centres += 7
    radii += 7
    assert (spheres.centres.tolist(), spheres.radii.tolist()) == (CENTRES, [1, 2, 3])


@pytest.mark.parametrize(
    ("centres", "radii", "message"),
    [
        pytest.param(np.zeros((3, 2)), 1, r"shape \(n, 3\), not \(3, 2\)", id="flat-centres"),
        pytest.param(np.zeros(3), 1, r"shape \(n, 3\), not \(3,\)", id="one-centre-without-brackets"),
        pytest.param(np.zeros((0, 3)), 1, "there are no spheres", id="empty"),
        pytest.param([["a", "b", "c"]], 1, "centres must be numbers", id="text"),
        pytest.param([[0, 0, 0], [0, 0]], 1, "rows differ in length", id="ragged"),
        pytest.param([[0, 0, 0], [0, np.nan, 0]], 1, "sphere 1 has a centre .*not finite: y = nan", id="nan-centre"),
        pytest.param([[0, 0, -np.inf]], 1, "sphere 0 .*: z = -inf", id="infinite-centre"),
        pytest.param(CENTRES, [1, 0, -1], "sphere 1 has the radius 0, but .*above 0", id="zero-radius"),
        pytest.param(CENTRES, [1, 1, -1.5], "sphere 2 has the radius -1.5", id="negative-radius"),
        pytest.param(CENTRES, [np.nan, 1, 1], "sphere 0 has the radius nan", id="nan-radius"),
        pytest.param(CENTRES, [1, np.inf, 1], "sphere 1 has the radius inf", id="infinite-radius"),
        pytest.param(CENTRES, -1, "sphere 0 has the radius -1", id="one-negative-radius"),
        pytest.param(CENTRES, [1, 2], r"one number or have shape \(3,\), not \(2,\)", id="too-few-radii"),
        pytest.param(CENTRES, [[1], [2], [3]], r"have shape \(3,\), not \(3, 1\)", id="column-of-radii"),
        pytest.param(CENTRES, ["a", "b", "c"], "radii must be numbers", id="text-radii"),
        pytest.param(np.ma.masked_equal(CENTRES, 4), 1, "some are masked", id="masked"),
        pytest.param(CENTRES, 1e160, "1e.160 units wide .*in another unit", id="too-wide"),
        pytest.param(np.zeros((1, 3)), 1e-160, "less than 3e-151 or more than 3e.150", id="too-small"),
        pytest.param([[-1.5e308, 0, 0], [1.5e308, 0, 0]], 1, "1.5e.308 units wide", id="wider-than-float64"),
        pytest.param(np.zeros((1, 3)), 1.7e308, "units wide", id="radius-wider-than-float64"),
    ],
)
def test_bad_arrays_are_refused_by_name(centres, radii, message):
    with pytest.raises(MeshError, match=message) as caught:
        Spheres(centres, radii, name="thing")
    assert str(caught.value).startswith("thing: ")


def test_moved_spheres_have_local_coordinates_of_their_own():
    spheres = Spheres(CENTRES, [1, 2, 0.5], name="thing")
    moved = spheres.with_spheres(spheres.centres * 2 + 100)
    assert (moved.radii.tolist(), moved.name) == ([1, 2, 0.5], "thing")
    assert moved.origin.tolist() == [104.5, 101.25, 100.25]
    assert moved.with_spheres(CENTRES, 3).radii.tolist() == [3, 3, 3]
    with pytest.raises(MeshError, match="thing: 2 spheres cannot replace the present 3"):
        spheres.with_spheres(CENTRES[:2])


def test_the_fingerprint_stands_for_what_determines_a_tree():
    spheres = Spheres(CENTRES, [1, 2, 0.5])
    assert Spheres(np.array(CENTRES) * 2 + 64, [2, 4, 1], name="other").fingerprint == spheres.fingerprint
    others = [Spheres(CENTRES, [1, 2, 0.5 + 1e-6]), Spheres(np.array(CENTRES) * [1, 1, 1 + 1e-6], [1, 2, 0.5])]
    assert len({spheres.fingerprint, *(other.fingerprint for other in others)}) == 3


def test_spheres_are_pickled_with_all_they_have():
    spheres = Spheres(CENTRES, [1, 2, 0.5], name="thing")
    again = pickle.loads(pickle.dumps(spheres))
    assert (again.name, again.scale, again.fingerprint) == ("thing", spheres.scale, spheres.fingerprint)
    assert again.centres.tobytes() == spheres.centres.tobytes()


def test_repr_says_what_it_is():
    assert repr(Spheres(CENTRES, 1, name="atoms")) == "Spheres('atoms', count=3)"


@pytest.mark.parametrize(
    ("centres", "radii"),
    [
        ([[1e308, 0, 0], [-1e308, 0, 0]], 1e308),
        ([[1.7e308, 0, 0], [-1.7e308, 0, 0]], 1e307),
        ([[1.7e308, 0, 0], [1, 1, 1]], 1.7e308),
        ([[1.7e308, 1.7e308, 0]], 1.7e308),
    ],
)
@pytest.mark.filterwarnings("error")
def test_spheres_that_leave_float64_are_refused(centres, radii):
    with pytest.raises(MeshError, match="units wide to each side of the centre"):
        Spheres(centres, radii)
