"""The camera of a picture: its position, direction and lens, and its rays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import SceneError
from ...support.memory import check_memory
from ...support.settings import Vector, check_settings, number, setting, vector
from .arrays import as_vector, read_array
from .lens import Lens, check_size
from .pose import find_signs, make_axes, read_pose, rotate_about_axis
from .projection import DEFAULT_FOV, DEFAULT_UP, PROJECTION, Fisheye, Orthographic, Panorama, check_focus, name_of
from .rays import RayModel, find_ray_model, pixel_centres_of

# Directions and a copy of them on the way, and as much for origins; the coordinates of curved projections and their
# steps.
_BYTES_PER_RAY = 48
_BYTES_PER_CURVED_RAY = 200


@dataclass(frozen=True)
class Camera:
    """A camera: an immutable value, in the coordinates of the scene or the mesh.

    Made from an eye, a point to look at and a field of view, or by `from_intrinsics` from a calibrated camera. Its
    picture is a perspective one, unless it has another projection.

    Attributes
    ----------
    eye, look_at : (3,) float, the scene's coordinates
        For a camera with a lens, `look_at` is any point on its optical axis.
    up : (3,) float
        The direction that is up in the picture; any length, not parallel to the line of sight.
    fov : float
        Vertical field of view in degrees, above 0 and below 180. For a camera with a lens it follows from the lens;
        other projections than perspective do not use it.
    lens : Lens or None
        Intrinsics in pixels, for a picture of one size. None: square pixels, the optical axis in the middle of the
        picture, and any size.
    projection : Orthographic, Fisheye, Panorama or None
        None: perspective. The others have no lens.
    aperture : float, the scene's units
        Diameter of the lens's opening, from which samples of a pixel start: depth of field. 0: all is sharp. For
        perspective and orthographic cameras.
    focus_distance : float or None, the scene's units
        Depth at which a camera with an aperture is sharp. None: that of `look_at`.

    Raises
    ------
    SceneError
        A vector is not three finite numbers, `eye` equals `look_at`, `up` is parallel to the line of sight, or a value
        is out of range or does not go with the projection or the lens.

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
    up: Vector = setting(DEFAULT_UP, "Up in the picture.", vector())
    fov: float = setting(DEFAULT_FOV, "Vertical field of view in degrees.", number(above=0, below=180))
    lens: Lens | None = None
    projection: Orthographic | Fisheye | Panorama | None = setting(None, "None: perspective.", PROJECTION)
    aperture: float = setting(0.0, "Diameter of the lens's opening.", number(0))
    focus_distance: float | None = setting(None, "Depth that is sharp.", number(above=0))

    def __post_init__(self) -> None:
        # Tuples of Python numbers, so that cameras can be compared and hashed.
        for name in ("eye", "look_at"):
            object.__setattr__(self, name, vector().take(f"the camera's {name}", getattr(self, name)))
        check_settings(self, "the camera's ")
        if self.lens is not None:
            if not isinstance(self.lens, Lens):
                raise SceneError(f"the camera's lens must be a Lens or None, not {self.lens!r}")
            if self.fov not in (DEFAULT_FOV, self.lens.fov):
                raise SceneError(
                    f"the camera's fov follows from its lens, {self.lens.fov:.6g} degrees, and cannot be {self.fov}"
                )
            if self.projection is not None:
                raise SceneError(f"a lens is that of a perspective camera: the {name_of(self.projection)} one has none")
            if self.aperture and self.focus_distance is None:
                raise SceneError("a camera with a lens and an aperture needs a focus_distance, as look_at is arbitrary")
            object.__setattr__(self, "fov", self.lens.fov)
        check_focus(self.projection, self.aperture)
        if self.projection == Orthographic():
            raise SceneError("an orthographic camera needs a height, as in clbvh.Orthographic(height=2)")
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
        distortion: ArrayLike | None = None,
        aperture: float = 0.0,
        focus_distance: float | None = None,
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
        distortion : (4,) or (5,) float, optional
            OpenCV's k1, k2, p1, p2 and k3, the ``distCoeffs`` of ``cv2.calibrateCamera``. The picture shows what the
            distorting camera sees.
        aperture, focus_distance : float, the scene's units
            Depth of field, see `Camera`.

        Returns
        -------
        Camera

        Raises
        ------
        SceneError
            `K` is no intrinsic matrix, the pose is not rigid or mirrors, the size or the convention is invalid, or the
            distortion has no inverse in all of the picture.

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
        lens = Lens.from_matrix(K, size, pixel_centres, distortion)
        up, forward, eye = read_pose(camera_to_world, convention)
        # Far enough that the point's rounding does not turn the line of sight.
        exponent = max(0, math.frexp(float(np.abs(eye).max()))[1])
        with np.errstate(over="ignore", invalid="ignore"):  # refused by the constructor
            look_at = eye + np.ldexp(1.0, exponent) * forward
        place = as_vector(eye), as_vector(look_at), as_vector(up)
        return cls(*place, lens=lens, aperture=aperture, focus_distance=focus_distance)

    def axes(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the unit vectors right, up and forward of the picture, each (3,) float64.

        Examples
        --------
        >>> import clbvh
        >>> right, up, forward = clbvh.Camera(eye=(0, -5, 0), look_at=(0, 0, 0), up=(0, 0, 1)).axes()
        >>> right, up, forward
        (array([1., 0., 0.]), array([0., 0., 1.]), array([0., 1., 0.]))
        """
        return self._axes

    @cached_property
    def _axes(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        with np.errstate(over="ignore"):  # refused by name
            forward = np.subtract(self.look_at, self.eye)
        axes = make_axes(forward, np.asarray(self.up, np.float64))
        for axis in axes:
            axis.flags.writeable = False
        return axes

    def intrinsics(
        self, width: int | None = None, height: int | None = None, *, pixel_centres: str = "half"
    ) -> NDArray[np.float64]:
        """Return the intrinsic matrix for a picture of this size, (3, 3) float64; see `from_intrinsics`.

        Raises
        ------
        SceneError
            The camera is not a perspective one, or see `size_for`.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), fov=90).intrinsics(640, 480).round(6).tolist()
        [[240.0, 0.0, 320.0], [0.0, 240.0, 240.0], [0.0, 0.0, 1.0]]
        """
        width, height = self.size_for(width, height)
        if self.projection is not None:
            raise SceneError(
                f"an intrinsic matrix is that of a perspective camera: the {name_of(self.projection)} one has none"
            )
        lens = Lens.from_fov(self.fov, width, height) if self.lens is None else self.lens.resized(width, height)
        return lens.matrix(pixel_centres)

    def camera_to_world(self, convention: str = "opencv") -> NDArray[np.float64]:
        """Return the pose, (4, 4) float64; see `from_intrinsics`.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0)).camera_to_world("opengl").tolist()
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 5.0], [0.0, 0.0, 0.0, 1.0]]
        """
        pose = np.eye(4)
        pose[:3, :3] = np.stack(self.axes(), axis=1) * find_signs(convention)
        pose[:3, 3] = self.eye
        return pose + 0.0  # no negative zeros

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
            In the scene's coordinates; directions of length 1, so that the t of a hit is its distance from the eye, or
            from the plane of an orthographic camera. Row 0 is the top. The origins are a read-only view of one point,
            but for an orthographic camera. Pixels outside the circle of a fisheye have rays, too: see `sees`.

        Raises
        ------
        SceneError
            A camera without a lens lacks a side, the aspect ratio is not the lens's, or rows that the picture does not
            have.

        Notes
        -----
        With an aperture, these are the rays through the middle of the lens.

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
        per_ray = _BYTES_PER_RAY * (2 if isinstance(self.projection, Orthographic) else 1)
        if not isinstance(self.projection, Orthographic | None) or (self.lens is not None and self.lens.distortion):
            per_ray += _BYTES_PER_CURVED_RAY
        check_memory(f"the rays of {len(rows):,} rows", len(rows) * width * per_ray, SceneError)
        return self._make_rays(width, height, *pixel_centres_of(width, height, rows))

    def rays_at(
        self, pixels: ArrayLike, width: int | None = None, height: int | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rays through points of the picture: the inverse of `project`.

        Parameters
        ----------
        pixels : (..., 2) float, pixels
            To the right and downwards from the upper left corner: (0.5, 0.5) is the centre of the first pixel.
        width, height : int
            See `rays`.

        Returns
        -------
        origins, directions : (..., 3) float64
            See `rays`.

        Raises
        ------
        SceneError
            The points are no array of finite numbers of this shape, or see `rays`.

        Examples
        --------
        >>> import clbvh
        >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), fov=90)
        >>> camera.rays_at([[320, 240], [320, 0]], 640, 480)[1].round(6) + 0.0
        array([[ 0.      ,  0.      , -1.      ],
               [ 0.      ,  0.707107, -0.707107]])
        """
        width, height = self.size_for(width, height)
        points = read_array("the pixels of rays", pixels, (..., 2))
        film_x, film_y = 2 * points[..., 0] / width - 1, 1 - 2 * points[..., 1] / height
        return self._make_rays(width, height, film_x, film_y)

    def sees(self, width: int | None = None, height: int | None = None) -> NDArray[np.bool_]:
        """Return whether each pixel has a ray: all but those outside the circle of a fisheye.

        Parameters
        ----------
        width, height : int
            See `rays`.

        Returns
        -------
        (height, width) bool

        Examples
        --------
        >>> import clbvh
        >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), projection=clbvh.Fisheye())
        >>> camera.sees(4, 2).astype(int)
        array([[0, 1, 1, 0],
               [0, 1, 1, 0]])
        """
        width, height = self.size_for(width, height)
        seen = self._ray_model(width, height).sees(*pixel_centres_of(width, height, range(height)))
        return np.array(np.broadcast_to(seen, (height, width)))

    def project(
        self, points: ArrayLike, width: int | None = None, height: int | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where points appear in a picture of this size.

        Parameters
        ----------
        points : (..., 3) float
            In the scene's coordinates.
        width, height : int
            See `rays`.

        Returns
        -------
        pixels : (..., 2) float64
            To the right and downwards from the upper left corner: the pixel in row i and column j covers j to j + 1 and
            i to i + 1. Outside these limits for points beside the picture; NaN for points that no ray reaches: behind
            the camera, outside the circle of a fisheye, or where a distorting lens would show them twice.
        depth : (...) float64, the scene's units
            Along the optical axis; negative behind the camera.

        Raises
        ------
        SceneError
            The points are no array of finite numbers of this shape, or see `rays`.

        Examples
        --------
        >>> import clbvh
        >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), fov=90)
        >>> pixels, depth = camera.project([[0, 0, 0], [5, 0, 0]], width=640, height=480)
        >>> pixels.round(6).tolist(), depth.tolist()
        ([[320.0, 240.0], [560.0, 240.0]], [5.0, 5.0])
        """
        width, height = self.size_for(width, height)
        seen = read_array("the points that a camera projects", points, (..., 3)) - np.asarray(self.eye, np.float64)
        x, y, z = (seen @ axis for axis in self.axes())
        film_x, film_y = self._ray_model(width, height).film(x, y, z)
        return np.stack(((film_x + 1) * (width / 2), (1 - film_y) * (height / 2)), axis=-1), z

    def cosines(self, width: int | None = None, height: int | None = None) -> NDArray[np.float64]:
        """Return the cosine between each pixel's ray and the optical axis: depth is t times this.

        Parameters
        ----------
        width, height : int
            See `rays`.

        Returns
        -------
        (height, width) float64
            Above 0, but for what a fisheye or a panorama sees behind itself. Depth, the z of depth cameras and of
            OpenCV, is the distance along the optical axis; t is the distance from the eye.

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
        degrees = number().take("the degrees by which a camera orbits", degrees)
        if about is None and self.lens is not None:
            raise SceneError("a camera with a lens has no point to orbit: give one as `about`")
        centre = vector().take("the point that a camera orbits", self.look_at if about is None else about)
        direction = vector().take("the axis that a camera orbits around", self.up if axis is None else axis)
        if not any(direction):
            raise SceneError("the axis that a camera orbits around must not be zero")
        # Whole turns are left out in degrees, where they are exact.
        angle = math.radians(math.fmod(degrees, 360.0))
        rotation = rotate_about_axis(np.asarray(direction, np.float64), angle)

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
        return check_size(width, height)

    def _ray_model(self, width: int, height: int) -> RayModel:
        """Return how points of a picture of this size become rays."""
        return find_ray_model(self.projection, self.lens, self.fov, width, height)

    def _make_rays(
        self, width: int, height: int, film_x: NDArray[np.float64], film_y: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rays through points of the picture, which broadcast."""
        model, (right, up, forward) = self._ray_model(width, height), self.axes()
        x, y, z = (np.asarray(part, np.float64)[..., None] for part in model.directions(film_x, film_y))
        directions = z * forward + x * right + y * up
        directions /= np.sqrt((directions * directions).sum(axis=-1, keepdims=True))
        eye = np.asarray(self.eye, np.float64)
        if not isinstance(self.projection, Orthographic):
            return np.broadcast_to(eye, directions.shape), directions
        x, y = (part[..., None] for part in model.window.points(film_x, film_y))
        return eye + x * right + y * up, directions

    @property
    def focus(self) -> float:
        """Depth of the plane that is sharp, in the scene's units: `focus_distance`, or else that of `look_at`.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), aperture=0.1).focus
        5.0
        """
        return math.dist(self.eye, self.look_at) if self.focus_distance is None else self.focus_distance
