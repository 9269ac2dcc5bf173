"""The environment of a scene: a panorama of linear light."""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError

ENVIRONMENT_SUFFIXES = (".hdr", ".exr")

# 16384 x 8192: indices of three channels are int32 on the device, and float32 tells columns and rows apart.
_MAX_PIXELS = 2**27
_MAX_SIDE = 2**16

# Sums of brighter light over many samples would leave float32.
_MAX_LIGHT = 1e20


class EnvironmentMap:
    """A panorama of the light around all objects; an immutable value, read when it is first needed.

    Parameters
    ----------
    source : str, path or (h, w, 3) array
        A file, ``.hdr`` or ``.exr``, or linear red, green and blue, 0 or more; row 0 is the zenith's.

    Attributes
    ----------
    path : str, or None
        Of the file.

    Raises
    ------
    SceneError
        The name of the file has another suffix, or the array another shape or type, or a pixel that is no light.

    Examples
    --------
    >>> import clbvh
    >>> import numpy as np
    >>> sky = np.zeros((32, 64, 3))
    >>> sky[:16] = (0.6, 0.7, 1.0)
    >>> clbvh.View(shading="path", environment=sky).environment
    EnvironmentMap(64 x 32)
    """

    path: str | None = None

    def __init__(self, source: Any) -> None:
        if isinstance(source, str | os.PathLike):
            self.path = os.fsdecode(source)
            if Path(self.path).suffix.lower() not in ENVIRONMENT_SUFFIXES:
                raise SceneError(
                    f"the environment must be a file whose name ends in {' or '.join(ENVIRONMENT_SUFFIXES)}, "
                    f"not {self.path!r}"
                )
        else:
            self.pixels = _check_pixels(source)

    @cached_property
    def pixels(self) -> NDArray[np.float32]:
        """(h, w, 3) float32, linear; raises `SceneError` or `ConfigError` if the file has none.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.EnvironmentMap([[[1, 2, 3]]]).pixels
        array([[[1., 2., 3.]]], dtype=float32)
        """
        assert self.path is not None
        from .environment_files import read_environment_map  # most pictures have no environment

        try:
            return _check_pixels(read_environment_map(self.path))
        except SceneError as error:
            if str(error).startswith(self.path):
                raise
            raise SceneError(f"{self.path}: {error}") from None

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, EnvironmentMap):
            return NotImplemented
        if self.path is not None or other.path is not None:
            return self.path == other.path
        return np.array_equal(self.pixels, other.pixels)

    def __hash__(self) -> int:
        return hash(self.pixels.shape if self.path is None else self.path)

    def __repr__(self) -> str:
        if self.path is not None:
            return f"EnvironmentMap({self.path!r})"
        height, width, _ = self.pixels.shape
        return f"EnvironmentMap({width} x {height})"


def as_environment(source: Any) -> EnvironmentMap | None:
    """Return the environment of a setting: a map, what a map is made from, or None."""
    return source if source is None or isinstance(source, EnvironmentMap) else EnvironmentMap(source)


def _check_pixels(source: Any) -> NDArray[np.float32]:
    """Return a read-only copy of an array as float32."""
    try:
        given = np.asarray(source)
    except ValueError as error:  # rows of different lengths
        raise SceneError(f"the environment must be a path or an (h, w, 3) array of numbers: {error}") from error
    if given.ndim != 3 or given.shape[2] != 3 or given.dtype.kind not in "iuf" or given.size == 0:
        raise SceneError(
            "the environment must be a path or an (h, w, 3) array of numbers, "
            f"not an array of {given.dtype} of shape {given.shape}"
        )
    height, width, _ = given.shape
    if height * width > _MAX_PIXELS or max(height, width) > _MAX_SIDE:
        raise SceneError(
            f"the environment has {width:,} x {height:,} pixels, and there is room for {_MAX_PIXELS:,}, "
            f"{_MAX_SIDE:,} on a side: make it smaller"
        )
    is_light = (given >= 0) & (given <= _MAX_LIGHT)  # False for NaN
    if not is_light.all():
        row, column, channel = (int(index) for index in np.argwhere(~is_light)[0])
        raise SceneError(
            f"the environment's light must be finite, from 0 to {_MAX_LIGHT:g}, "
            f"but the {('red', 'green', 'blue')[channel]} at row {row}, column {column} is "
            f"{given[row, column, channel]}"
        )
    pixels = np.array(given, np.float32, order="C")
    pixels.flags.writeable = False
    return pixels
