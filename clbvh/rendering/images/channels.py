"""The channels of images for programs: their names, their types, and how each follows from a picture."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ConfigError
from ...geometry import Shape
from ...geometry.appearance.srgb import srgb_to_linear
from ...trace.hits.hits import Hits
from ..camera import Camera
from ..picture import Picture
from .motion import NextPose
from .shading_normals import find_shading_normals
from .texture_coordinates import find_texture_coordinates

DEFAULT_CHANNELS = ("rgb", "alpha", "depth", "normal", "instance_id")


@dataclass(frozen=True, eq=False)
class Subject:
    """What the channels are computed from.

    Attributes
    ----------
    picture : Picture
    shapes : sequence of Mesh or Spheres
        By geometry id.
    next_pose : NextPose
    crease_angle : float
        Degrees; see `Scene.smooth`.
    """

    picture: Picture
    shapes: Sequence[Shape]
    next_pose: NextPose
    crease_angle: float

    @property
    def hits(self) -> Hits:
        """The hits of the picture in float64."""
        return self.picture.hits

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """(height, width, 3) float64: normals of the primitives towards the camera, 0 on a miss."""
        return _clear_misses(self.hits.normals(facing=True))

    @cached_property
    def shading_normals(self) -> NDArray[np.float64]:
        """The same of those that light is computed with."""
        return _clear_misses(find_shading_normals(self.hits, self.shapes, self.crease_angle))


@dataclass(frozen=True)
class Channel:
    """One channel.

    Attributes
    ----------
    find : function
        Returns the array of a `Subject`.
    kind : str
        ``"rgb"``, ``"colour"``, ``"share"`` from 0 to 1, ``"distance"``, ``"direction"`` of length 1, ``"id"`` or
        ``"vector"``: decides how integers of 16 bits hold it.
    exr_names : tuple of str
        The channels of an EXR file; none for 8-bit colours.
    pixel_bytes : int
    """

    find: Callable[[Subject], NDArray[Any]]
    kind: str
    exr_names: tuple[str, ...]
    pixel_bytes: int

    @property
    def needs_shading(self) -> bool:
        """Whether it depends on light and materials."""
        return self.kind in ("rgb", "colour", "share")


def check_channels(channels: Iterable[str]) -> tuple[str, ...]:
    """Return the names of channels, each once; raise `ConfigError` for one that does not exist."""
    names = (channels,) if isinstance(channels, str) else channels
    try:
        names = tuple(dict.fromkeys(names))
    except TypeError as error:
        raise ConfigError(f"the channels are a sequence of names, not {channels!r}") from error
    for name in names:
        if name not in CHANNELS:
            raise ConfigError(f"there is no channel {name!r}: the channels are {', '.join(CHANNELS)}")
    if not names:
        raise ConfigError(f"give at least one channel: {', '.join(CHANNELS)}")
    return names


def find_limits(channel: str, array: NDArray[Any]) -> tuple[float, float] | None:
    """Return the least and the greatest value of the hits of a channel; None if there is none."""
    kind = CHANNELS[channel].kind
    known = array[array >= 0] if kind == "id" else array[np.isfinite(array)]
    return (known.min().item(), known.max().item()) if len(known) else None


def turn_to_camera(normals: ArrayLike, camera: Camera) -> NDArray[np.float64]:
    """Return directions, (..., 3), along the axes of a camera: x right, y down, z forward."""
    return np.asarray(normals) @ camera.camera_to_world("opencv")[:3, :3]


def _find_colour(subject: Subject) -> NDArray[np.float32]:
    if (film := subject.picture.film) is not None:
        return np.ascontiguousarray(film[..., :3])
    # The shadings with one ray for each pixel have no film: the 8 bits are decoded.
    table = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
    return table[subject.picture.rgb]


def _find_alpha(subject: Subject) -> NDArray[np.float32]:
    if (film := subject.picture.film) is not None:
        return np.ascontiguousarray(film[..., 3])
    return np.divide(subject.picture.alpha, 255, dtype=np.float32)


def _find_barycentric(subject: Subject) -> NDArray[np.float32]:
    hits = subject.hits
    pair = np.stack((hits.u, hits.v), axis=-1).astype(np.float32)
    pair[~hits.is_hit] = np.nan
    return pair


def _clear_misses(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return normals as a plain array with 0 in place of NaN."""
    return np.nan_to_num(np.asarray(normals), copy=False, nan=0.0)


def _as_single(find: Callable[[Subject], NDArray[np.floating]]) -> Callable[[Subject], NDArray[np.float32]]:
    return lambda subject: find(subject).astype(np.float32)


def _vector(name: str, axes: str) -> tuple[str, ...]:
    return tuple(f"{name}.{axis}" for axis in axes)


CHANNELS = {
    "rgb": Channel(lambda subject: subject.picture.rgb, "rgb", (), 3),
    "colour": Channel(_find_colour, "colour", ("R", "G", "B"), 12),
    "alpha": Channel(_find_alpha, "share", ("A",), 4),
    "depth": Channel(_as_single(lambda subject: subject.picture.depth), "distance", ("depth.Z",), 4),
    "range": Channel(_as_single(lambda subject: subject.hits.t), "distance", ("range.Z",), 4),
    "normal": Channel(_as_single(lambda subject: subject.normals), "direction", _vector("normal", "XYZ"), 12),
    "normal_camera": Channel(
        _as_single(lambda subject: turn_to_camera(subject.normals, subject.picture.camera)),
        "direction", _vector("normal_camera", "XYZ"), 12,
    ),
    "shading_normal": Channel(
        _as_single(lambda subject: subject.shading_normals), "direction", _vector("shading_normal", "XYZ"), 12
    ),
    "shading_normal_camera": Channel(
        _as_single(lambda subject: turn_to_camera(subject.shading_normals, subject.picture.camera)),
        "direction", _vector("shading_normal_camera", "XYZ"), 12,
    ),
    "position": Channel(lambda subject: subject.hits.locations, "vector", _vector("position", "XYZ"), 24),
    "instance_id": Channel(lambda subject: subject.hits.instance_id, "id", ("instance_id.ID",), 4),
    "geometry_id": Channel(lambda subject: subject.hits.geometry_id, "id", ("geometry_id.ID",), 4),
    "primitive_id": Channel(lambda subject: subject.hits.prim_id, "id", ("primitive_id.ID",), 4),
    "barycentric": Channel(_find_barycentric, "vector", _vector("barycentric", "UV"), 8),
    "uv": Channel(
        lambda subject: find_texture_coordinates(subject.hits, subject.shapes), "vector", _vector("uv", "UV"), 8
    ),
    "motion": Channel(
        lambda subject: subject.next_pose.find_motion(subject.picture), "vector", _vector("motion", "XY"), 8
    ),
}  # fmt: skip
