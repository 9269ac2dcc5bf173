"""Cameras in JSON files: the matrix, the pose and the size, as `Images.save` writes them beside PNG files."""

from __future__ import annotations

import json
import os
from pathlib import Path

from ..errors import SceneError
from ..support.regular_file import read_errors_as, read_regular
from .camera import Camera

_NEEDED = ("intrinsics", "camera_to_world", "size")
_OPTIONAL = ("convention", "pixel_centres")

_MOST_BYTES = 1 << 26


def read_camera(path: str | os.PathLike[str]) -> Camera:
    """Return the camera of a JSON file.

    Parameters
    ----------
    path : str or path
        An object with `intrinsics` (3, 3), `camera_to_world` (4, 4), `size` (width, height) and, if needed,
        `convention` and `pixel_centres`: the arguments of `Camera.from_intrinsics`. Other keys are left alone.

    Raises
    ------
    SceneError
        The file cannot be read, or it describes no camera.
    """
    with read_errors_as(SceneError, path):
        content = read_regular(Path(path), max_bytes=_MOST_BYTES)
    try:
        facts = json.loads(content)
    except ValueError as error:
        raise SceneError(f"{path}: this is no JSON file: {error}") from error
    if not isinstance(facts, dict):
        raise SceneError(f"{path}: a camera file holds an object with {', '.join(_NEEDED)}")
    if missing := [key for key in _NEEDED if key not in facts]:
        raise SceneError(f"{path}: a camera file needs {', '.join(_NEEDED)}, and here is no {missing[0]}")
    try:
        return Camera.from_intrinsics(
            facts["intrinsics"],
            facts["camera_to_world"],
            facts["size"],
            **{key: facts[key] for key in _OPTIONAL if key in facts},
        )
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
