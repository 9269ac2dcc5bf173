"""The channels of images for programs: their names, their types, and how each follows from a picture."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ConfigError, SceneError
from ..geometry import Mesh, Shape
from ..geometry.appearance.srgb import srgb_to_linear
from ..scene.scene import Scene
from ..scene.transforms import check_transform
from ..trace.hits.hits import Hits
from ..trace.hits.interpolate import group_by_geometry
from ..trace.hits.surface import Surface
from ..trace.world.surface_arrays import SurfacePoints
from ..views.cameras.camera import Camera
from .look_tables import find_corner_normals
from .picture import Picture


@dataclass(frozen=True, eq=False)
class Subject:
    """What the channels are computed from.

    Attributes
    ----------
    picture : Picture
    next_pose : NextPose
    crease_angle : float
        Degrees; see `View.smooth`.
    """

    picture: Picture
    next_pose: NextPose
    crease_angle: float

    @property
    def hits(self) -> Hits:
        """The hits of the picture in float64."""
        return self.picture.hits

    @property
    def shapes(self) -> Sequence[Shape]:
        """The shapes by geometry id."""
        return self.picture.scene.state.shapes

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """(height, width, 3) float64: normals of the primitives towards the camera, 0 on a miss."""
        return _clear_misses(self.hits.normals(facing=True))

    @cached_property
    def shading_normals(self) -> NDArray[np.float64]:
        """The same of those that light is computed with."""
        return _clear_misses(find_shading_normals(self.hits, self.shapes, self.crease_angle))

    def turn_to_camera(self, normals: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return directions, (..., 3), along the axes of the camera: x right, y down, z forward."""
        return normals @ self.picture.camera.camera_to_world("opencv")[:3, :3]


@dataclass(frozen=True)
class Channel:
    """One channel.

    Attributes
    ----------
    find : function
        Returns the values of a `Subject`.
    kind : str
        ``"rgb"``, ``"colour"``, ``"share"`` from 0 to 1, ``"distance"``, ``"direction"`` of length 1, ``"id"`` or
        ``"vector"``: decides how integers of 16 bits hold it.
    exr_names : tuple of str
        The channels of an EXR file; none for 8-bit colours.
    dtype : type
        Of the array.
    """

    find: Callable[[Subject], NDArray[Any]]
    kind: str
    exr_names: tuple[str, ...]
    dtype: type = np.float32

    @property
    def pixel_bytes(self) -> int:
        """Bytes of the array for each pixel."""
        return np.dtype(self.dtype).itemsize * (len(self.exr_names) or 3)

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


def _vector(name: str, axes: str) -> tuple[str, ...]:
    return tuple(f"{name}.{axis}" for axis in axes)


def _direction(name: str, find: Callable[[Subject], NDArray[Any]]) -> Channel:
    return Channel(find, "direction", _vector(name, "XYZ"))


def _id(name: str, find: Callable[[Subject], NDArray[Any]]) -> Channel:
    return Channel(find, "id", (f"{name}.ID",), np.int32)


CHANNELS = {
    "rgb": Channel(lambda subject: subject.picture.rgb, "rgb", (), np.uint8),
    "colour": Channel(_find_colour, "colour", ("R", "G", "B")),
    "alpha": Channel(_find_alpha, "share", ("A",)),
    "depth": Channel(lambda subject: subject.picture.depth, "distance", ("depth.Z",)),
    "range": Channel(lambda subject: subject.hits.t, "distance", ("range.Z",)),
    "normal": _direction("normal", lambda subject: subject.normals),
    "normal_camera": _direction("normal_camera", lambda subject: subject.turn_to_camera(subject.normals)),
    "shading_normal": _direction("shading_normal", lambda subject: subject.shading_normals),
    "shading_normal_camera": _direction(
        "shading_normal_camera", lambda subject: subject.turn_to_camera(subject.shading_normals)
    ),
    "position": Channel(lambda subject: subject.hits.locations, "vector", _vector("position", "XYZ"), np.float64),
    "instance_id": _id("instance_id", lambda subject: subject.hits.instance_id),
    "geometry_id": _id("geometry_id", lambda subject: subject.hits.geometry_id),
    "prim_id": _id("prim_id", lambda subject: subject.hits.prim_id),
    "barycentric": Channel(_find_barycentric, "vector", _vector("barycentric", "UV")),
    "uv": Channel(
        lambda each: find_texture_coordinates(each.hits, each.picture.scene.state.shapes), "vector", _vector("uv", "UV")
    ),
    "motion": Channel(lambda each: each.next_pose.find_motion(each.picture), "vector", _vector("motion", "XY")),
}


# The sum of unit vectors is no direction if its square is smaller: they cancel each other.
_LEAST_SQUARE = 2.0**-40


def find_shading_normals(hits: Hits, shapes: Sequence[Shape], crease_angle: float) -> NDArray[np.float64]:
    """Return (..., 3) float64: unit normals on the side from which the rays came, NaN on a miss.

    Parameters
    ----------
    hits : Hits
        They know the sides of their rays.
    shapes : sequence of Mesh or Spheres
        By the geometry ids of the hits.
    crease_angle : float
        Degrees. Meshes without normals are smooth over edges that turn by less; 0: over none.
    """
    normals = np.array(hits.normals(facing=True)).reshape(-1, 3)
    instances = np.asarray(hits.instance_id).reshape(-1)
    for rows, blended in _blend_corners(hits, shapes, lambda mesh: find_corner_normals(mesh, float(crease_angle))):
        squares = np.einsum("ij,ij->i", blended, blended)
        is_direction = squares > _LEAST_SQUARE
        blended /= np.sqrt(np.where(is_direction, squares, 1.0))[:, None]
        assert hits.surface is not None  # or they would have no normals
        blended = hits.surface.turn_normals(instances[rows], blended)
        # To the side of the face, on which the ray came: files do not always agree with the order of corners.
        sides = np.einsum("ij,ij->i", blended, normals[rows])
        is_kept = is_direction & (sides != 0) & np.isfinite(sides)
        normals[rows] = np.where(is_kept[:, None], blended * np.sign(sides)[:, None], normals[rows])
    return normals.reshape(*hits.prim_id.shape, 3)


def _blend_corners(
    hits: Hits, shapes: Sequence[Shape], find_corners: Callable[[Mesh], NDArray[np.float32] | None]
) -> Iterator[tuple[NDArray[np.integer], NDArray[np.float64]]]:
    """Yield rows of hits on meshes, and the values, (n, k), of the corners of their faces, (F, 3, k), interpolated."""
    prims, us, vs = (np.asarray(values).reshape(-1) for values in (hits.prim_id, hits.u, hits.v))
    for geometry, rows in group_by_geometry(np.asarray(hits.geometry_id).reshape(-1)):
        shape = shapes[geometry]
        corners = find_corners(shape) if isinstance(shape, Mesh) else None
        if corners is None:
            continue
        a, b, c = corners[prims[rows]].astype(np.float64).transpose(1, 0, 2)
        yield rows, a + ((b - a) * us[rows, None] + (c - a) * vs[rows, None])


def find_texture_coordinates(hits: Hits, shapes: Sequence[Shape]) -> NDArray[np.float32]:
    """Return (..., 2) float32: NaN on a miss, and on shapes without texture coordinates.

    Parameters
    ----------
    hits : Hits
    shapes : sequence of Mesh or Spheres
        By the geometry ids of the hits.
    """
    result = np.full((hits.prim_id.size, 2), np.nan, np.float32)
    for rows, uvs in _blend_corners(
        hits, shapes, lambda mesh: None if mesh.appearance is None else mesh.appearance.uvs
    ):
        result[rows] = uvs
    return result.reshape(*hits.prim_id.shape, 2)


# Pixels whose points are in memory at a time.
_CHUNK_PIXELS = 1 << 20


class NextPose:
    """The second pose of a camera and of instances, checked.

    Parameters
    ----------
    scene : Scene
        Of the first pose.
    camera : Camera or None
        None: that of the picture.
    transforms : mapping of instances, ids or names to (4, 4) float, or None
        From the coordinates of each instance's geometry to the scene's. The others stay where they are.

    Raises
    ------
    SceneError
        No camera, an instance that the scene does not have, or a matrix that is not finite, not affine or singular.
    """

    def __init__(self, scene: Scene, camera: Camera | None, transforms: Mapping[Any, ArrayLike] | None) -> None:
        if camera is not None and not isinstance(camera, Camera):
            raise SceneError(f"the next camera must be a clbvh.Camera, not {camera!r}")
        if transforms is not None and not isinstance(transforms, Mapping):
            raise SceneError(f"the next transforms must be a mapping, {{instance: matrix, ...}}, not {transforms!r}")
        moved = transforms or {}
        self._camera = camera
        self._ids = scene.instance_ids([*moved])
        checked = [check_transform(matrix, f"the next transform of {key!r}") for key, matrix in moved.items()]
        self._matrices = np.array(checked).reshape(-1, 4, 4)

    def check(self) -> None:
        """Raise `ConfigError` unless there is anything that can differ from the first pose."""
        if self._camera is None and not len(self._ids):
            raise ConfigError("the channel motion needs a second pose: give next_camera or next_transforms")

    def find_motion(self, picture: Picture) -> NDArray[np.float32]:
        """Return (height, width, 2) float32: pixels to the right and downwards, NaN on a miss; see `Images`."""
        height, width = picture.found.shape
        camera, surface, hits = self._camera or picture.camera, self._move_surface(picture), picture.hits
        motion = np.full((height * width, 2), np.nan, np.float32)
        seen = np.flatnonzero(hits.is_hit)
        for begin in range(0, len(seen), _CHUNK_PIXELS):
            pixels = seen[begin : begin + _CHUNK_PIXELS]
            centres = np.stack((pixels % width + 0.5, pixels // width + 0.5), axis=-1)
            of_pixels = hits.take(pixels)
            points = SurfacePoints(of_pixels.prim_id, of_pixels.instance_id, of_pixels.u, of_pixels.v)
            locations = of_pixels.locations if surface is None else surface.locate(points)
            motion[pixels] = camera.project(locations, width, height)[0] - centres
        return motion.reshape(height, width, 2)

    def _move_surface(self, picture: Picture) -> Surface | None:
        """Return the surface in the second pose; None if no instance moves."""
        if not len(self._ids):
            return None
        state = picture.scene.state
        state = state.with_transforms(state.check_ids(self._ids), self._matrices)
        return Surface.from_shapes(state.shapes, state.names, state.geometry_ids, state.transforms)
