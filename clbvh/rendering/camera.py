"""The camera of a picture: its position, direction and lens, and its rays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from ..support.memory import check_memory
from .lens import Lens, Window, check_size, is_finite_number, window_of
from .pose import make_axes, make_pose, read_pose, rotate_about_axis
from .vectors import Vector, as_vector, check_vector

# Directions, and a copy of them on the way.
_BYTES_PER_RAY = 48

DEFAULT_FOV = 35.0
DEFAULT_UP: Vector = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: a value that never changes, in the coordinates of the scene or the mesh.

    Made from an eye, a point to look at and a field of view, or by `from_intrinsics` from a calibrated camera.

    Attributes
    ----------
    eye, look_at : (3,) float, the scene's coordinates
        For a camera with a lens, `look_at` is any point on its optical axis.
    up : (3,) float
        The direction that is up in the picture; any length, not parallel to the line of sight.
    fov : float
        Vertical field of view in degrees, above 0 and below 180. For a camera with a lens it follows from the lens.
    lens : Lens or None
        Intrinsics in pixels, for a picture of one size. None: square pixels, the optical axis in the middle of the
        picture, and any size.

    Raises
    ------
    SceneError
        A vector is not three finite numbers, `eye` equals `look_at`, `up` is parallel to the line of sight, or the
        field of view is out of range or not that of the lens.

    Notes
    -----
    Row 0 of a picture is its top. The pixel in row i and column j covers the rows i to i + 1 and the columns j to
    j + 1, and its ray goes through its centre, (j + 0.5, i + 0.5).

    Examples
    --------
    >>> import clbvh
    >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), fov=90)
    >>> origins, directions = camera.rays(width=3, height=3)
    >>> directions.shape
    (3, 3, 3)
    >>> directions[1, 1].tolist()
    [0.0, 0.0, -1.0]
    """

    eye: Vector
    look_at: Vector
    up: Vector = DEFAULT_UP
    fov: float = DEFAULT_FOV
    lens: Lens | None = None

    def __post_init__(self) -> None:
        for name in ("eye", "look_at", "up"):
            check_vector(f"the camera's {name}", getattr(self, name))
            # Tuples of Python numbers, so that cameras can be compared and hashed.
            object.__setattr__(self, name, as_vector(getattr(self, name)))
        if self.lens is not None:
            if not isinstance(self.lens, Lens):
                raise SceneError(f"the camera's lens must be a Lens or None, not {self.lens!r}")
            if self.fov not in (DEFAULT_FOV, self.lens.fov):
                raise SceneError(
                    f"the camera's fov follows from its lens, {self.lens.fov:.6g} degrees, and cannot be {self.fov}"
                )
            object.__setattr__(self, "fov", self.lens.fov)
        check_fov(self.fov)
        object.__setattr__(self, "fov", float(self.fov))
        self.axes()

    @classmethod
    def from_intrinsics(
        cls,
        K: ArrayLike,  # noqa: N803 - the field's name of this matrix
        camera_to_world: ArrayLike,
        size: tuple[int, int],
        convention: str = "opencv",
        *,
        pixel_centres: str = "half",
    ) -> Camera:
        """Return the camera of an intrinsic matrix and a pose.

        Parameters
        ----------
        K : (3, 3) float, pixels
            ``[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]``, with image coordinates to the right and downwards from the
            upper left corner, in both conventions. fx and fy may differ, the principal point (cx, cy) may be anywhere.
        camera_to_world : (4, 4) float
            The pose: a rotation and the eye, in the scene's coordinates. The inverse of the extrinsic matrix of OpenCV,
            Open3D and COLMAP. Errors of up to 1e-4, as in rounded files, are corrected to the nearest rotation.
        size : (width, height), pixels
            Size of the picture that `K` describes. A picture of another size and the same aspect ratio shows the same
            view; another aspect ratio is refused.
        convention : str
            The axes of the pose. ``"opencv"``: x right, y down, z forward, as in OpenCV, COLMAP and Open3D.
            ``"opengl"``: x right, y up, z backward, as in OpenGL, Blender, glTF, NeRF, pyrender and trimesh.
        pixel_centres : str
            The centre of the pixel in row i and column j, in the coordinates of `K`. ``"half"``: at (j + 0.5, i + 0.5),
            as in OpenGL, COLMAP, Open3D and pyrender; a lens without shift has ``cx = width / 2``. ``"integer"``: at
            (j, i), as in OpenCV's calibration; it has ``cx = (width - 1) / 2``.

        Returns
        -------
        Camera

        Raises
        ------
        SceneError
            `K` is no intrinsic matrix, the pose is not rigid or mirrors, or the size or the convention is invalid.

        Examples
        --------
        >>> import clbvh
        >>> K = [[500, 0, 310], [0, 510, 250], [0, 0, 1]]
        >>> pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -5], [0, 0, 0, 1]]
        >>> camera = clbvh.Camera.from_intrinsics(K, pose, size=(640, 480))
        >>> camera.eye
        (0.0, 0.0, -5.0)
        >>> origins, directions = camera.rays()
        >>> directions.shape
        (480, 640, 3)
        """
        lens = Lens.from_matrix(K, size, pixel_centres)
        up, forward, eye = read_pose(camera_to_world, convention)
        # Far enough that the point's rounding does not turn the line of sight.
        exponent = max(0, math.frexp(float(np.abs(eye).max()))[1])
        with np.errstate(over="ignore", invalid="ignore"):  # refused by the constructor
            look_at = eye + np.ldexp(1.0, exponent) * forward
        return cls(as_vector(eye), as_vector(look_at), as_vector(up), lens.fov, lens)

    def axes(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the unit vectors right, up and forward of the picture, each (3,) float64.

        Examples
        --------
        >>> import clbvh
        >>> right, up, forward = clbvh.Camera(eye=(0, -5, 0), look_at=(0, 0, 0), up=(0, 0, 1)).axes()
        >>> right, up, forward
        (array([1., 0., 0.]), array([0., 0., 1.]), array([0., 1., 0.]))
        """
        with np.errstate(over="ignore"):  # refused by name
            forward = np.subtract(self.look_at, self.eye)
        return make_axes(forward, np.asarray(self.up, np.float64))

    def intrinsics(
        self, width: int | None = None, height: int | None = None, *, pixel_centres: str = "half"
    ) -> NDArray[np.float64]:
        """Return the intrinsic matrix for a picture of this size, (3, 3) float64; see `from_intrinsics`.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), fov=90).intrinsics(640, 480).round(6).tolist()
        [[240.0, 0.0, 320.0], [0.0, 240.0, 240.0], [0.0, 0.0, 1.0]]
        """
        return self._lens_for(*self.size_for(width, height)).matrix(pixel_centres)

    def camera_to_world(self, convention: str = "opencv") -> NDArray[np.float64]:
        """Return the pose, (4, 4) float64; see `from_intrinsics`.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0)).camera_to_world("opengl").tolist()
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 5.0], [0.0, 0.0, 0.0, 1.0]]
        """
        return make_pose(*self.axes(), np.asarray(self.eye, np.float64), convention)

    def rays(
        self, width: int | None = None, height: int | None = None, rows: range | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rays of a picture of this size, one through the centre of each pixel.

        Parameters
        ----------
        width, height : int
            Size of the picture. For a camera with a lens, missing sides follow from the lens.
        rows : range, optional
            Only these rows of the picture.

        Returns
        -------
        origins, directions : (height, width, 3) float64
            In the scene's coordinates; directions of length 1, so that the t of a hit is its distance from the eye.
            Row 0 is the top. The origins are a read-only view of one point.

        Raises
        ------
        SceneError
            A camera without a lens lacks a side, the aspect ratio is not the lens's, or rows that the picture does not
            have.

        Examples
        --------
        >>> import clbvh
        >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0))
        >>> with clbvh.Tracer(clbvh.build(clbvh.make_shape("icosphere", triangles=320))) as tracer:
        ...     hits = tracer.closest_hit(*camera.rays(64, 48))
        >>> hits.t.shape
        (48, 64)
        """
        width, height = self.size_for(width, height)
        rows = range(height) if rows is None else rows
        if not isinstance(rows, range) or (rows and not (min(rows) >= 0 and max(rows) < height)):
            raise SceneError(f"the rows of a picture of {height} rows must be a range within them, not {rows!r}")
        check_memory(f"the rays of {len(rows):,} rows", len(rows) * width * _BYTES_PER_RAY, SceneError)
        right, up, forward = self.axes()
        window = find_window(self, width, height)
        x = (2 * np.arange(width) + 1) / width - 1
        y = 1 - (2 * np.asarray(rows, np.int64) + 1) / height
        upwards = window.centre_y + y * window.half_height
        across = (window.centre_x + x * window.half_width)[None, :]
        if window.shear:
            across = across + (window.shear * upwards)[:, None]
        directions = forward + across[..., None] * right + upwards[:, None, None] * up
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(np.asarray(self.eye, np.float64), directions.shape), directions

    def cosines(self, width: int | None = None, height: int | None = None) -> NDArray[np.float64]:
        """Return the cosine between each pixel's ray and the optical axis: depth is t times this.

        Parameters
        ----------
        width, height : int
            See `rays`.

        Returns
        -------
        (height, width) float64
            Above 0. Depth, the z of depth cameras and of OpenCV, is the distance along the optical axis; t is the
            distance from the eye.

        Examples
        --------
        >>> import clbvh
        >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), fov=90)
        >>> camera.cosines(3, 3).round(3)[1].tolist()
        [0.832, 1.0, 0.832]
        """
        return self.rays(width, height)[1] @ self.axes()[2]

    def orbit(self, degrees: float, *, about: Vector | None = None, axis: Vector | None = None) -> Camera:
        """Return the camera after a rotation around a point, which keeps the distance to the point.

        Parameters
        ----------
        degrees : float
            Counterclockwise, seen from the tip of the axis; the object appears to turn clockwise.
        about : (3,) float, optional
            By default `look_at`; required for a camera with a lens, whose `look_at` is arbitrary.
        axis : (3,) float, optional
            By default `up`.

        Returns
        -------
        Camera

        Raises
        ------
        SceneError
            A value is not finite, the axis is zero, or a camera with a lens gets no point.

        Examples
        --------
        >>> import clbvh
        >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0))
        >>> [round(part, 6) for part in camera.orbit(90).eye]
        [5.0, 0.0, 0.0]
        """
        if not is_finite_number(degrees):
            raise SceneError(f"a camera orbits by a finite number of degrees, not {degrees!r}")
        if about is None and self.lens is not None:
            raise SceneError("a camera with a lens has no point to orbit: give one as `about`")
        centre, direction = self.look_at if about is None else about, self.up if axis is None else axis
        check_vector("the point that a camera orbits", centre)
        check_vector("the axis that a camera orbits around", direction)
        if not any(direction):
            raise SceneError("the axis that a camera orbits around must not be zero")
        # Whole turns are left out in degrees, where they are exact.
        angle = math.radians(math.fmod(degrees, 360.0))
        centre, rotation = as_vector(np.asarray(centre)), rotate_about_axis(np.asarray(direction, np.float64), angle)

        def turn(point: Vector) -> Vector:
            return as_vector(np.asarray(centre) + rotation @ np.subtract(point, centre))

        # `look_at` stays exact where it is the centre of the rotation.
        look_at = self.look_at if centre == self.look_at else turn(self.look_at)
        return replace(self, eye=turn(self.eye), look_at=look_at, up=as_vector(rotation @ np.asarray(self.up)))

    def size_for(self, width: int | None, height: int | None) -> tuple[int, int]:
        """Return the size of a picture; missing sides follow from the lens.

        Raises
        ------
        SceneError
            A camera without a lens lacks a side, or the aspect ratio is not the lens's.

        Examples
        --------
        >>> import clbvh
        >>> lens = clbvh.Lens.from_fov(40, 640, 480)
        >>> clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), lens=lens).size_for(320, None)
        (320, 240)
        """
        if self.lens is not None:
            return self.lens.complete_size(width, height)
        if width is None or height is None:
            raise SceneError("a camera without a lens has no size: give the width and the height of the picture")
        check_size(width, height)
        return int(width), int(height)

    def _lens_for(self, width: int, height: int) -> Lens:
        """Return the intrinsics of a picture of this size."""
        if self.lens is not None:
            return self.lens.resized(width, height)
        return Lens.from_fov(self.fov, width, height)


def find_window(camera: Camera, width: int, height: int) -> Window:
    """Return the window of a picture of this size in the plane at distance 1 from the eye."""
    if camera.lens is not None:
        return window_of(camera.lens.resized(width, height))
    half_height = math.tan(math.radians(camera.fov) / 2)
    return Window(0.0, 0.0, half_height * width / height, half_height, 0.0)


def check_fov(fov: float) -> None:
    """Raise `SceneError` unless the field of view is above 0 and below 180 degrees."""
    if isinstance(fov, bool) or not isinstance(fov, Real) or not 0 < fov < 180:
        raise SceneError(f"the camera's fov must be above 0 and below 180 degrees, not {fov}")
