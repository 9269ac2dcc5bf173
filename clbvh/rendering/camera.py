"""The camera of a picture: its position and direction, its rays, and the automatic view of a mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh

Vector = tuple[float, float, float]

DEFAULT_FOV = 35.0
DEFAULT_UP: Vector = (0.0, 1.0, 0.0)

# The automatic view: from the front, a little from the right and from above, with a margin around the mesh.
_AZIMUTH_DEGREES = 30.0
_ELEVATION_DEGREES = 18.0
_MARGIN = 0.06

# A mesh without extent still needs a distance; in local units.
_SMALLEST_DISTANCE = 1e-6

# Vertices per step when the mesh is framed: 10 MB at a time.
_CHUNK_VERTICES = 2**17


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes
    ----------
    eye, look_at : (3,) float, the scene's coordinates
    up : (3,) float
        The direction that is up in the picture; any length, not parallel to the line of sight.
    fov : float
        Vertical field of view in degrees, above 0 and below 180.

    Raises
    ------
    SceneError
        A vector is not three finite numbers, `eye` equals `look_at`, `up` is parallel to the line of sight, or the
        field of view is out of range.
    """

    eye: Vector
    look_at: Vector
    up: Vector = DEFAULT_UP
    fov: float = DEFAULT_FOV

    def __post_init__(self) -> None:
        check_fov(self.fov)
        for name in ("eye", "look_at", "up"):
            check_vector(f"the camera's {name}", getattr(self, name))
        self.axes()

    def axes(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the unit vectors right, up and forward of the picture, each (3,) float64."""
        return make_axes(np.subtract(self.look_at, self.eye), np.asarray(self.up, np.float64))

    def rays(
        self, width: int, height: int, rows: range | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rays of a picture of this size, one through the centre of each pixel.

        Parameters
        ----------
        width, height : int
        rows : range, optional
            Only these rows of the picture.

        Returns
        -------
        origins, directions : (height, width, 3) float64
            In the scene's coordinates; directions of length 1. Row 0 is the top.
        """
        right, up, forward = self.axes()
        half_height = math.tan(math.radians(self.fov) / 2)
        half_width = half_height * width / height
        x = (2 * np.arange(width) + 1) / width - 1
        y = 1 - (2 * np.asarray(rows or range(height)) + 1) / height
        directions = forward + (x * half_width)[None, :, None] * right + (y * half_height)[:, None, None] * up
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(np.asarray(self.eye, np.float64), directions.shape), directions


def check_fov(fov: float) -> None:
    """Raise `SceneError` unless the field of view is above 0 and below 180 degrees."""
    if not isinstance(fov, Real) or not 0 < fov < 180:
        raise SceneError(f"the camera's fov must be above 0 and below 180 degrees, not {fov}")


def check_vector(name: str, value: object) -> None:
    """Raise `SceneError` unless a value is three finite numbers."""
    try:
        array = np.asarray(value)
        is_vector = array.shape == (3,) and array.dtype.kind in "iuf" and bool(np.isfinite(array).all())
    except ValueError:  # rows of different lengths
        is_vector = False
    if not is_vector:
        raise SceneError(f"{name} must be three finite numbers, not {value!r}")


def make_axes(
    forward: NDArray[np.float64], up: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return right, up and forward as unit vectors at right angles; raise `SceneError` if two are parallel."""
    # Scaled first: the squares of a short or long vector need not be in float64.
    longest = np.abs(forward).max()
    if not longest > 0:
        raise SceneError("the camera's eye and look_at are the same point")
    forward = forward / longest
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up / max(float(np.linalg.norm(up)), np.finfo(float).tiny))
    length = np.linalg.norm(right)
    if not length > 1e-9:
        raise SceneError("the camera's up is zero or parallel to its line of sight")
    right = right / length
    return right, np.cross(right, forward), forward


def frame_mesh(
    mesh: Mesh,
    *,
    aspect: float,
    up: Vector = DEFAULT_UP,
    fov: float = DEFAULT_FOV,
    eye: Vector | None = None,
) -> Camera:
    """Return a camera that sees all of a mesh from a three-quarter view, as close as possible.

    Parameters
    ----------
    mesh : Mesh
    aspect : float
        Width of the picture divided by its height.
    up : (3,) float
        The direction that is up in the picture.
    fov : float
        Vertical field of view in degrees.
    eye : (3,) float, optional
        A fixed position; the camera looks at the middle of the mesh's box.

    Notes
    -----
    The nearest position for the direction of view is exact: a point at (x, y, z) along right, up and forward is inside
    the picture if abs(x - eye_x) <= (z - eye_z) tan(fov / 2), and likewise for y; the tightest of these bounds over all
    points give eye_x, eye_y and eye_z in closed form.
    """
    check_fov(fov)
    if eye is not None:
        return Camera(eye, _as_vector(mesh.origin), up, fov)
    right, upward, forward = make_axes(-_three_quarter_direction(up), np.asarray(up, np.float64))
    tangents = np.array([aspect, 1.0]) * math.tan(math.radians(fov) / 2) * (1 - _MARGIN)

    # The planes of the view's four sides, moved inwards until they touch the points. In local coordinates.
    highest = np.full(2, -np.inf)
    lowest = np.full(2, np.inf)
    nearest, farthest = np.inf, -np.inf
    across = np.stack([right, upward], axis=1)
    for begin in range(0, len(mesh.local_vertices), _CHUNK_VERTICES):
        chunk = mesh.local_vertices[begin : begin + _CHUNK_VERTICES].astype(np.float64)
        depth = chunk @ forward
        offset = chunk @ across
        highest = np.maximum(highest, (offset - depth[:, None] * tangents).max(axis=0))
        lowest = np.minimum(lowest, (offset + depth[:, None] * tangents).min(axis=0))
        nearest, farthest = min(nearest, depth.min()), max(farthest, depth.max())

    distance = float(((highest - lowest) / (2 * tangents)).max())
    size = max(farthest - nearest, float((highest - lowest).max()), _SMALLEST_DISTANCE)
    # A flat mesh seen edge-on touches no side, and no point may lie behind the eye.
    distance = max(distance, -nearest + 1e-3 * size)
    centre = (highest + lowest) / 2
    local_eye = across @ centre - distance * forward
    local_target = local_eye + forward * (distance + (nearest + farthest) / 2)
    eye_point, look_at = mesh.origin + local_eye / mesh.scale, mesh.origin + local_target / mesh.scale
    return Camera(_as_vector(eye_point), _as_vector(look_at), up, fov)


def _three_quarter_direction(up: Vector) -> NDArray[np.float64]:
    """Return the unit vector from the mesh towards the camera."""
    upward = np.asarray(up, np.float64)
    if not np.isfinite(upward).all() or not np.linalg.norm(upward) > 0:
        raise SceneError(f"the camera's up must be a finite direction of length above 0, not {up}")
    upward = upward / np.linalg.norm(upward)
    # The front is +z if y is up, and -y if z is up, as in modelling programs.
    front = np.array([0.0, 0.0, 1.0]) if abs(upward[2]) < abs(upward[1]) else np.array([0.0, -1.0, 0.0])
    front = front - upward * (front @ upward)
    front /= np.linalg.norm(front)
    side = np.cross(upward, front)
    azimuth, elevation = math.radians(_AZIMUTH_DEGREES), math.radians(_ELEVATION_DEGREES)
    level = math.cos(azimuth) * front + math.sin(azimuth) * side
    return math.cos(elevation) * level + math.sin(elevation) * upward


def _as_vector(values: NDArray[np.float64]) -> Vector:
    return float(values[0]), float(values[1]), float(values[2])
