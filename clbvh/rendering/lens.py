"""The intrinsics of a camera: where its pixels lie in the plane at distance 1 from the eye.

Must not know the position of the camera: that is `pose.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from .distortion import check_invertible, read_distortion
from .finite_number import is_finite_number
from .matrices import read_matrix, show_matrix
from .window import Window

# The fraction in the coordinates of pixel centres: 0.5 if the pixel with index j covers the columns j to j + 1, as in
# OpenGL, COLMAP and Open3D; 0 if whole numbers are the centres, as in OpenCV's calibration.
PIXEL_CENTRES = {"half": 0.5, "integer": 0.0}

# Largest focal length and largest offset of the principal point, in picture sizes; the inverse is the smallest focal
# length. Beyond these, float32 cannot tell the field of view from 0 or from 180 degrees.
_MOST = 1e9

# Tolerance of the aspect ratio, in pixels of either side: half of an odd side is no whole number.
_SHAPE_SLACK_PIXELS = 1.0


@dataclass(frozen=True)
class Lens:
    """The intrinsics of a camera for a picture of one size, in pixels.

    Attributes
    ----------
    fx, fy : float
        Focal lengths.
    cx, cy : float
        Principal point, from the left and upper sides of the picture: the centre of the pixel in row i and column j is
        at (j + 0.5, i + 0.5).
    skew : float
        Entry (0, 1) of the matrix; 0 if rows and columns are at right angles.
    width, height : int
        Size of the picture.
    distortion : (5,) float or None
        OpenCV's k1, k2, p1, p2 and k3; k3 may be left out. None: a pinhole.

    Raises
    ------
    SceneError
        A focal length is not above 0, a value is out of range, or the distortion folds inside the picture.

    Examples
    --------
    >>> import clbvh
    >>> lens = clbvh.Lens.from_matrix([[500, 0, 310], [0, 510, 250], [0, 0, 1]], (640, 480))
    >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), lens=lens)
    >>> lens.fx, lens.cy, round(camera.fov, 3)
    (500.0, 250.0, 50.388)
    """

    fx: float
    fy: float
    cx: float
    cy: float
    skew: float
    width: int
    height: int
    distortion: tuple[float, float, float, float, float] | None = None

    def __post_init__(self) -> None:
        check_size(self.width, self.height)
        for name, value in (("fx", self.fx), ("fy", self.fy), ("cx", self.cx), ("cy", self.cy), ("skew", self.skew)):
            if not is_finite_number(value):
                raise SceneError(f"the camera's {name} must be a finite number of pixels, not {value!r}")
            # Python's numbers, whatever was given: sizes of a short type would overflow in products.
            object.__setattr__(self, name, float(value))
        for name in ("width", "height"):
            object.__setattr__(self, name, int(getattr(self, name)))
        for name, value, side in (("fx", self.fx, self.width), ("fy", self.fy, self.height)):
            if not value > 0:
                raise SceneError(
                    f"the camera's {name} must be above 0, not {value:g}: the matrix looks along +z of the image, and "
                    f"`convention` says which axes the pose has"
                )
            if not 1 / _MOST <= value / side <= _MOST:
                raise SceneError(f"the camera's {name} of {value:g} pixels is no focal length for a side of {side}")
        offset = max(abs(self.cx / self.width), abs(self.cy / self.height), abs(self.skew) / self.fx)
        if offset > _MOST:
            raise SceneError(
                f"the camera's principal point ({self.cx:g}, {self.cy:g}) and skew {self.skew:g} are too far from a "
                f"picture of {self.width} x {self.height}"
            )
        object.__setattr__(self, "distortion", read_distortion(self.distortion))
        if self.distortion is not None:
            check_invertible(window_of(self), self.distortion)

    @classmethod
    def from_matrix(
        cls,
        matrix: ArrayLike,
        size: tuple[int, int],
        pixel_centres: str = "half",
        distortion: ArrayLike | None = None,
    ) -> Lens:
        """Return the lens of an intrinsic matrix, see `Camera.from_intrinsics`.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Lens.from_matrix([[500, 0, 320], [0, 500, 240], [0, 0, 1]], (640, 480)).cx
        320.0
        """
        try:
            width, height = size
        except (TypeError, ValueError) as error:
            raise SceneError(f"the camera's size must be (width, height) in pixels, not {size!r}") from error
        centre = _find_centre(pixel_centres)
        k = read_matrix("the camera's intrinsic matrix", matrix, (3, 3))
        if k[1, 0] or k[2, 0] or k[2, 1] or k[2, 2] != 1:
            raise SceneError(
                f"the camera's intrinsic matrix must be [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], not {show_matrix(k)}"
            )
        shift = 0.5 - centre
        fx, skew, fy = float(k[0, 0]), float(k[0, 1]), float(k[1, 1])
        return cls(
            fx, fy, float(k[0, 2]) + shift, float(k[1, 2]) + shift, skew, width, height, read_distortion(distortion)
        )

    @classmethod
    def from_fov(cls, fov: float, width: int, height: int) -> Lens:
        """Return the lens with this vertical field of view in degrees, square pixels and a centred principal point.

        Examples
        --------
        >>> import clbvh
        >>> lens = clbvh.Lens.from_fov(90, 640, 480)
        >>> round(lens.fx, 6), lens.cx, lens.cy
        (240.0, 320.0, 240.0)
        """
        check_size(width, height)
        focal = height / 2 / math.tan(math.radians(fov) / 2)
        return cls(focal, focal, width / 2, height / 2, 0.0, width, height)

    def matrix(self, pixel_centres: str = "half") -> NDArray[np.float64]:
        """Return the intrinsic matrix, (3, 3) float64, pixels.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Lens.from_fov(90, 640, 480).matrix().round(6)
        array([[240.,   0., 320.],
               [  0., 240., 240.],
               [  0.,   0.,   1.]])
        """
        shift = 0.5 - _find_centre(pixel_centres)
        return np.array([[self.fx, self.skew, self.cx - shift], [0.0, self.fy, self.cy - shift], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> Lens:
        """Return the lens for a picture of another size that shows the same view.

        Raises
        ------
        SceneError
            The other size has another aspect ratio.

        Examples
        --------
        >>> import clbvh
        >>> half = clbvh.Lens.from_fov(90, 640, 480).resized(320, 240)
        >>> half.width, half.cx, round(half.fx, 6)
        (320, 160.0, 120.0)
        """
        if (width, height) == (self.width, self.height):
            return self
        check_size(width, height)
        width, height = int(width), int(height)
        off_width = abs(width - height * self.width / self.height)
        off_height = abs(height - width * self.height / self.width)
        if min(off_width, off_height) > _SHAPE_SLACK_PIXELS:
            raise SceneError(
                f"the camera's intrinsics are those of a picture of {self.width} x {self.height}, and {width} x "
                f"{height} has another aspect ratio: give a size of the same one, or make the camera for that size"
            )
        across, down = width / self.width, height / self.height
        return replace(
            self, fx=self.fx * across, fy=self.fy * down, cx=self.cx * across, cy=self.cy * down,
            skew=self.skew * across, width=width, height=height,
        )  # fmt: skip

    def complete_size(self, width: int | None, height: int | None) -> tuple[int, int]:
        """Return the size of a picture; missing sides follow from the lens's size and aspect ratio.

        Raises
        ------
        SceneError
            A side is no number of pixels, or the size has another aspect ratio.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Lens.from_fov(90, 640, 480).complete_size(None, 240)
        (320, 240)
        """
        if width is None:
            check_size(1, height if height is not None else 1)
            width = self.width if height is None else max(1, round(int(height) * self.width / self.height))
        check_size(width, height if height is not None else 1)
        if height is None:
            height = max(1, round(int(width) * self.height / self.width))
        self.resized(width, height)
        return int(width), int(height)

    @property
    def fov(self) -> float:
        """The angle from the upper to the lower side of the picture at the principal point's column, in degrees.

        Without distortion.
        """
        above, below = self.cy / self.fy, (self.height - self.cy) / self.fy
        # The sum of both arc tangents, without cancellation where the principal point is far outside the picture.
        return math.degrees(math.atan2(above + below, 1 - above * below))


def window_of(lens: Lens) -> Window:
    """Return the lens's picture in the plane at distance 1."""
    return Window(
        centre_x=(lens.width / 2 - lens.cx) / lens.fx,
        centre_y=(lens.cy - lens.height / 2) / lens.fy,
        half_width=lens.width / 2 / lens.fx,
        half_height=lens.height / 2 / lens.fy,
        shear=lens.skew / lens.fx,
    )


def check_size(width: object, height: object) -> None:
    """Raise `SceneError` unless these are the sides of a picture in pixels."""
    for name, side in (("width", width), ("height", height)):
        if isinstance(side, bool) or not isinstance(side, Integral) or side < 1:
            raise SceneError(f"the {name} of a camera's picture must be a whole number of pixels, not {side!r}")
        if int(side) > _MOST:
            raise SceneError(f"the {name} of a camera's picture must be at most {_MOST:g} pixels")


def _find_centre(pixel_centres: str) -> float:
    if not isinstance(pixel_centres, str) or pixel_centres not in PIXEL_CENTRES:
        raise SceneError(f"pixel_centres must be one of {', '.join(PIXEL_CENTRES)}, not {pixel_centres!r}")
    return PIXEL_CENTRES[pixel_centres]
