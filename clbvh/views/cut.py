"""Cuts: a part of the world that the camera does not see, so that closed rooms are open.

Imports no numpy until rays are cut, see `settings.py`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..errors import SceneError
from ..support.settings import Vector, vector

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# The names of `first` and `second` in messages.
_PARTS = {
    "plane": ("point", "normal"),
    "share": ("point, in per cent,", "normal"),
    "box": ("lower corner", "upper corner"),
}
_AXES = "xyz"
_WHOLE = 100.0  # per cent

# A height along an axis, in the scene's unit or in per cent, and the side that is cut away.
_HEIGHT = re.compile(rf"([{_AXES}])([=<>])(.+?)(%?)")


@dataclass(frozen=True)
class Cut:
    """A part of the world that the camera does not see: one side of a plane, or the inside of a box.

    Only the rays of the camera pass through what is cut away. Light, shadows and reflections are those of the whole
    world, as in a doll's house. Made by `Cut.plane`, `Cut.box` and `as_cut`.

    Attributes
    ----------
    kind : str
        ``"plane"``, ``"box"``, or ``"share"``: a plane whose point is in per cent of a scene, see `resolved`.
    first, second : (3,) float, the scene's coordinates
        Of a plane a point and the normal, on whose side nothing is shown; of a box the lower and the upper corner.

    Raises
    ------
    SceneError
        A vector is not finite, the normal is zero, or the lower corner is above the upper one.

    Examples
    --------
    >>> import clbvh
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> half = clbvh.Cut.plane((0, 0, 0), (0, 0, 1))
    >>> picture = clbvh.render(ball, cut=half, side="front", up="y", width=64, height=48)
    >>> bool((picture.hits.locations[..., 2] < 1e-6).any())
    True
    """

    kind: str
    first: Vector
    second: Vector

    @classmethod
    def plane(cls, point: Vector, normal: Vector) -> Cut:
        """Return a cut of all that lies on the normal's side of a plane through a point.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Cut.plane((0, 1, 0), (0, 2, 0))
        Cut(kind='plane', first=(0.0, 1.0, 0.0), second=(0.0, 2.0, 0.0))
        """
        return cls("plane", point, normal)

    @classmethod
    def box(cls, lower: Vector, upper: Vector) -> Cut:
        """Return a cut of all that lies inside an axis-parallel box.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Cut.box((0, 0, 0), (1, 2, 3)).kind
        'box'
        """
        return cls("box", lower, upper)

    def __post_init__(self) -> None:
        if self.kind not in _PARTS:
            raise SceneError(f"a cut is a 'plane', a 'share' or a 'box', not {self.kind!r}")
        for name, attribute in zip(_PARTS[self.kind], ("first", "second"), strict=True):
            value = vector().take(f"the {name} of a cut", getattr(self, attribute))
            object.__setattr__(self, attribute, value)
        if self.kind != "box":
            if not any(self.second):
                raise SceneError(f"the normal of a cut must be a direction of length above 0, not {self.second}")
        elif not all(low <= high for low, high in zip(self.first, self.second, strict=True)):
            raise SceneError(f"the lower corner of a cut, {self.first}, must not be above the upper one, {self.second}")

    @property
    def text(self) -> str:
        """The cut as a text, from which `as_cut` makes the same one.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Cut.box((0, 0, 0), (1, 2, 3)).text
        'box 0.0,0.0,0.0;1.0,2.0,3.0'
        """
        if self.kind == "share":
            axis = next(axis for axis in range(3) if self.second[axis])
            return f"{_AXES[axis]}{'=' if self.second[axis] > 0 else '<'}{self.first[axis]!r}%"
        vectors = ";".join(",".join(map(repr, vector)) for vector in (self.first, self.second))
        return vectors if self.kind == "plane" else f"box {vectors}"

    def resolved(self, lower: Vector | NDArray[np.float64], upper: Vector | NDArray[np.float64]) -> Cut:
        """Return the cut in the coordinates of a scene with this box: (3,) float each; per cent count from `lower`.

        Examples
        --------
        >>> from clbvh.views.cut import as_cut
        >>> as_cut("z=25%").resolved((0, 0, 0), (1, 2, 8))
        Cut(kind='plane', first=(0.0, 0.0, 2.0), second=(0.0, 0.0, 1.0))
        """
        if self.kind != "share":
            return self
        # A mean, which stays in float64 where a difference of the corners would not.
        x, y, z = (
            float(low) * (1 - share / _WHOLE) + float(high) * (share / _WHOLE)
            for share, low, high in zip(self.first, lower, upper, strict=True)
        )
        return Cut("plane", (x, y, z), self.second)

    def describe_miss(self, lower: Vector | NDArray[np.float64], upper: Vector | NDArray[np.float64]) -> str | None:
        """Return a note if a resolved cut takes nothing away from a scene with this box, (3,) float each; or None.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Cut.plane((0, 9, 0), (0, 1, 0)).describe_miss((0, 0, 0), (1, 2, 3))
        'the cut takes nothing away: all objects are in the box 0,0,0;1,2,3'
        """
        rows = list(zip(self.first, self.second, lower, upper, strict=True))
        if self.kind == "box":
            is_missed = any(first > high or second < low for first, second, low, high in rows)
        else:  # by the corner that is farthest on the normal's side
            is_missed = sum(((high if side > 0 else low) - point) * side for point, side, low, high in rows) <= 0
        corners = ";".join(",".join(f"{value:g}" for value in corner) for corner in (lower, upper))
        return f"the cut takes nothing away: all objects are in the box {corners}" if is_missed else None

    @property
    def normal(self) -> NDArray[np.float64]:
        """(3,) float64: the unit normal of a plane."""
        import numpy as np

        normal = np.asarray(self.second)
        # Scaled first: squares of short or long vectors need not be in float64.
        normal = normal / np.abs(normal).max()
        return normal / np.linalg.norm(normal)

    def ranges(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the parts of rays that are cut away, as t from `begin` to `end`; none where `end` is less.

        What is left are the t from 0 to `begin`, and those from `end` on: the limits of two calls of
        `Tracer.closest_hit`, of which the first one that hits answers.

        Parameters
        ----------
        origins, directions : (..., 3) float64
            As of `Camera.rays`.

        Returns
        -------
        begin, end : (...) float64

        Examples
        --------
        >>> import clbvh
        >>> begin, end = clbvh.Cut.box((0, 0, 0), (1, 2, 3)).ranges([0.5, 0.5, 10], [0, 0, -2])
        >>> float(begin), float(end)
        (3.5, 5.0)
        """
        import numpy as np

        origins, directions = np.asarray(origins, np.float64), np.asarray(directions, np.float64)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if self.kind == "plane":
                height = (origins - self.first) @ self.normal
                rising = directions @ self.normal
                crossing = -height / rising
                begin = np.where(rising > 0, crossing, -np.inf)
                end = np.where(rising < 0, crossing, np.inf)
                is_missed = (rising == 0) & ~(height > 0)
                return np.where(is_missed, np.inf, begin), np.where(is_missed, -np.inf, end)
            lower, upper = (np.asarray(corner) - origins for corner in (self.first, self.second))
            first, second = lower / directions, upper / directions
            is_level = directions == 0
            is_inside = (lower <= 0) & (upper >= 0)
            begin = np.where(is_level, np.where(is_inside, -np.inf, np.inf), np.minimum(first, second))
            end = np.where(is_level, np.where(is_inside, np.inf, -np.inf), np.maximum(first, second))
        return begin.max(axis=-1), end.min(axis=-1)

    def limit(
        self, t: NDArray[np.float64], origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return t of hits, moved out of the cut by what the device has rounded; misses stay infinite.

        Examples
        --------
        >>> import clbvh
        >>> import numpy as np
        >>> cut = clbvh.Cut.box((0, 0, 0), (1, 2, 3))
        >>> float(cut.limit(np.array(3.5000001), np.array([0.5, 0.5, 10]), np.array([0, 0, -2])))
        3.5
        """
        import numpy as np

        begin, end = self.ranges(origins, directions)
        with np.errstate(invalid="ignore"):
            is_before = (begin >= 0) & (t - begin <= end - t)
        limited = np.where(is_before, np.minimum(t, begin), np.maximum(t, end))
        return np.where((begin <= end) & np.isfinite(t), limited, t)


def as_cut(value: Any) -> Cut:
    """Return a cut, or that of a text, as in `View`.

    ``"z=50%"`` and ``"z>0.5"`` cut away what lies above a height, in per cent of the scene or in its unit, and
    ``"y<2"`` what lies below; ``"X,Y,Z;NX,NY,NZ"`` is a plane, and ``"box X,Y,Z;X,Y,Z"`` a box.

    Raises
    ------
    SceneError
        The text makes no cut.
    TypeError
        The value is something else.
    """
    if isinstance(value, Cut):
        return value
    if not isinstance(value, str):
        raise TypeError
    first: Any
    second: Any
    try:
        if not (found := _HEIGHT.fullmatch(value.replace(" ", ""))):
            corners = value.removeprefix("box ").split(";")
            first, second = ([float(part) for part in corner.split(",")] for corner in corners)
            return Cut("box" if value.startswith("box ") else "plane", first, second)
        name, side, number, unit = found.groups()
        height = float(number)
    except ValueError as error:
        if isinstance(error, SceneError):  # of numbers that make no cut
            raise
        raise SceneError(
            f'a cut is a text such as "z=50%", "z>0.5", "y<2", "0,1,0;0,1,0" or "box 0,0,0;1,1,1", not {value[:60]!r}'
        ) from None
    if unit and not 0 <= height <= _WHOLE:
        raise SceneError(f"a cut in per cent is at 0 to 100 % of the scene, not at {number} %")
    first, second = ([size if axis == name else 0.0 for axis in _AXES] for size in (height, 1.0 - 2.0 * (side == "<")))
    return Cut("share" if unit else "plane", first, second)
