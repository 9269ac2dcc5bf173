"""Cuts: a part of the world that the camera does not see, so that closed rooms are open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from .vectors import Vector, as_vector, check_vector


@dataclass(frozen=True)
class Cut:
    """A part of the world that the camera does not see: one side of a plane, or the inside of a box.

    Only the rays of the camera pass through what is cut away. Light, shadows and reflections are those of the whole
    world, as in a doll's house. Made by `Cut.plane` and `Cut.box`.

    Attributes
    ----------
    kind : str
        ``"plane"`` or ``"box"``.
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
    >>> picture = clbvh.render(clbvh.Scene(ball, cut=half, view="front"), width=64, height=48)
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
        if self.kind not in ("plane", "box"):
            raise SceneError(f"a cut is a 'plane' or a 'box', not {self.kind!r}")
        names = ("point", "normal") if self.kind == "plane" else ("lower corner", "upper corner")
        for name, attribute in zip(names, ("first", "second"), strict=True):
            value = getattr(self, attribute)
            check_vector(f"the {name} of a cut", value)
            object.__setattr__(self, attribute, as_vector(np.asarray(value, np.float64)))
        if self.kind == "plane" and not any(self.second):
            raise SceneError(f"the normal of a cut must be a direction of length above 0, not {self.second}")
        if self.kind == "box" and not all(low <= high for low, high in zip(self.first, self.second, strict=True)):
            raise SceneError(f"the lower corner of a cut, {self.first}, must not be above the upper one, {self.second}")

    @property
    def normal(self) -> NDArray[np.float64]:
        """(3,) float64: the unit normal of a plane."""
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
        begin, end = self.ranges(origins, directions)
        with np.errstate(invalid="ignore"):
            is_before = (begin >= 0) & (t - begin <= end - t)
        limited = np.where(is_before, np.minimum(t, begin), np.maximum(t, end))
        return np.where((begin <= end) & np.isfinite(t), limited, t)


def parse_cut(kind: str, text: str) -> Cut:
    """Return the cut of an option such as ``0,1,0;0,1,0``: two vectors with a semicolon between them.

    Raises
    ------
    SceneError
        The text is not two vectors, or they make no cut.
    """
    try:
        first, second = (tuple(float(number) for number in part.split(",")) for part in text.split(";"))
    except ValueError:
        first = second = ()
    if not len(first) == len(second) == 3:
        raise SceneError(f"a cut is two vectors in quotes, such as \"0,1,0;0,1,0\", and not '{text}'")
    return Cut(kind, first, second)
