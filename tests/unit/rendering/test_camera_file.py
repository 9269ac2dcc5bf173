"""Camera files give the camera of their matrices, and others are refused by name."""

from __future__ import annotations

import json

import numpy as np
import pytest

from clbvh import Camera, SceneError
from clbvh.rendering.images import read_camera

K = [[50.0, 1.0, 30.0], [0.0, 55.0, 20.0], [0.0, 0.0, 1.0]]
POSE = [[1.0, 0, 0, 0.4], [0, 0.6, -0.8, 4.0], [0, 0.8, 0.6, -3.2], [0, 0, 0, 1.0]]
FACTS = {"intrinsics": K, "camera_to_world": POSE, "size": [60, 40]}


def write(path, facts):
    path.write_text(json.dumps(facts))
    return path


def test_the_camera_is_that_of_the_matrices(tmp_path):
    assert read_camera(write(tmp_path / "a.json", FACTS)) == Camera.from_intrinsics(K, POSE, (60, 40))


def test_axes_and_pixel_centres_can_be_given_and_other_keys_are_left_alone(tmp_path):
    facts = FACTS | {"convention": "opengl", "pixel_centres": "integer", "channels": {}}
    expected = Camera.from_intrinsics(K, POSE, (60, 40), "opengl", pixel_centres="integer")
    assert read_camera(str(write(tmp_path / "a.json", facts))) == expected


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        (FACTS | {"size": [60]}, r"must be \(width, height\)"),
        (FACTS | {"intrinsics": np.eye(4).tolist()}, "intrinsic matrix"),
        (FACTS | {"camera_to_world": None}, "pose"),
        (FACTS | {"convention": "left"}, "convention must be one of"),
        ({"size": [60, 40]}, "here is no intrinsics"),
        ([1, 2], "holds an object"),
    ],
    ids=["size", "matrix", "pose", "convention", "missing", "list"],
)
def test_other_cameras_are_refused(tmp_path, facts, words):
    with pytest.raises(SceneError, match=rf"a\.json: .*{words}"):
        read_camera(write(tmp_path / "a.json", facts))


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a.json").write_text("solid")
    with pytest.raises(SceneError, match=r"a\.json: this is no JSON file"):
        read_camera(tmp_path / "a.json")
    with pytest.raises(SceneError, match="no such file"):
        read_camera(tmp_path / "b.json")
