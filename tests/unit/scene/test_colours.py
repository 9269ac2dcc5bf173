"""Colours of instances: kept with them, and checked."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import clbvh
from clbvh.errors import SceneError

BALL = clbvh.make_shape("icosphere", triangles=80)
RED, BLUE = (1.0, 0.25, 0.0), (0.0, 0.0, 1.0)
PLACES = np.tile(np.eye(4), (3, 1, 1))


@pytest.fixture
def scene():
    scene = clbvh.Scene()
    ball = scene.add(BALL)
    scene.place(ball)
    scene.place(ball, colour=RED)
    scene.place_many(ball, PLACES, colour=np.array([0, 0, 1]))
    return scene


def test_an_instance_has_the_colour_that_it_was_given(scene):
    assert [instance.colour for instance in scene.instances] == [None, RED, BLUE, BLUE, BLUE]


def test_the_state_has_colours_and_nan_without_one(scene):
    colours = scene.snapshot().colours
    assert colours.dtype == np.float64
    assert np.isnan(colours[0]).all()
    np.testing.assert_array_equal(colours[1:], [RED, BLUE, BLUE, BLUE])
    assert not colours.flags.writeable


def test_copies_and_other_scenes_keep_colours(scene):
    other = clbvh.Scene()
    other.add_parts(scene)
    for kept in (copy.copy(scene), pickle.loads(pickle.dumps(scene)), other):
        np.testing.assert_array_equal(kept.snapshot().colours, scene.snapshot().colours)
        assert [instance.colour for instance in kept.instances] == [instance.colour for instance in scene.instances]


def test_a_moved_state_keeps_its_colours(scene):
    state = scene.snapshot()
    moved = state.with_transforms([0], [np.diag([2, 2, 2, 1])])
    np.testing.assert_array_equal(moved.colours, state.colours)


@pytest.mark.parametrize(
    "colour", [(1, 2), 0.5, "red", (1, 2, np.nan), (1, np.inf, 0), [[1, 2, 3]], [(1, 2), 3, 4], (1j, 0, 0), True]
)
def test_anything_else_is_no_colour(scene, colour):
    ball = scene.geometries[0]
    with pytest.raises(SceneError, match="three finite numbers"):
        scene.place(ball, colour=colour)
    with pytest.raises(SceneError, match="three finite numbers"):
        scene.place_many(ball, PLACES, colour=colour)
    assert len(scene.instances) == 5
