"""Reads rays and points as the user gives them. Shapes are checked here, values when they are packed."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...errors import QueryError
from ...support.masked import has_masked_values
from .broadcast import Broadcast, broadcast_shape
from .ray_rows import RayRows

_FLOAT64 = np.dtype(np.float64)

_MOST_MASK = 0xFFFFFFFF


class RayBatch(NamedTuple):
    """Rays as the user gave them.

    Attributes
    ----------
    origins, directions : Broadcast of float32 or float64 vectors, the file's coordinates
    t_min, t_max : Broadcast of float64, lengths of the direction
    mask : Broadcast of uint32, or None
        The instances of a scene that are visible; None: all.
    """

    origins: Broadcast
    directions: Broadcast
    t_min: Broadcast
    t_max: Broadcast
    mask: Broadcast | None = None

    @property
    def ray_count(self) -> int:
        """Number of rays."""
        return math.prod(self.origins.shape)

    @property
    def is_contiguous(self) -> bool:
        """Whether parts are views, not copies."""
        return self.origins.is_contiguous and self.directions.is_contiguous

    def take(self, ray_ids: NDArray[np.integer]) -> RayBatch:
        """Return some of the rays, by their indices in C order."""
        origins, directions, t_min, t_max = (values.take(ray_ids) for values in self[:4])
        return RayBatch(origins, directions, t_min, t_max, None if self.mask is None else self.mask.take(ray_ids))

    def part(self, begin: int, end: int) -> RayRows:
        """Return rays `begin` to `end`, counted in C order."""
        origins, directions = self.vectors(begin, end)
        return RayRows(
            origins, directions, self.t_min.part(begin, end, _FLOAT64), self.t_max.part(begin, end, _FLOAT64)
        )

    def vectors(self, begin: int, end: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the origins and directions of rays `begin` to `end`, as in `RayRows`."""
        dtype = self.origins.items.dtype
        if dtype != self.directions.items.dtype:
            dtype = _FLOAT64
        return self.origins.part(begin, end, dtype), self.directions.part(begin, end, dtype)


class TreeBox(NamedTuple):
    """A box around the tree, symmetric about the mesh's origin, and the map to the mesh's local coordinates.

    Attributes
    ----------
    centre : (3,) float64, the file's coordinates
        The mesh's origin.
    scale : float
        A power of two: local units in one unit of the file.
    half : (3,) float64, local coordinates
        Half the size along each axis; the largest is about 1, or 0.
    """

    centre: NDArray[np.float64]
    scale: float
    half: NDArray[np.float64]

    @classmethod
    def around(cls, bvh: Bvh) -> TreeBox:
        """Return the box around a tree."""
        root = bvh.nodes[0]
        half = np.maximum(np.abs(root["aabb_min"]), np.abs(root["aabb_max"])).astype(np.float64)
        return cls(bvh.mesh.origin, bvh.mesh.scale, half)


def read_rays(
    origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike, mask: ArrayLike | None = None
) -> tuple[RayBatch, tuple[int, ...]]:
    """Return rays as a batch, without a copy where possible, and the leading shape that they are broadcast to.

    Raises
    ------
    QueryError
        A wrong shape, shapes that do not broadcast, or a limit that is out of range.
    """
    origins, directions = read_vectors(origins, "origins"), read_vectors(directions, "directions")
    try:
        shape = broadcast_shape(origins.shape[:-1], directions.shape[:-1])
    except ValueError:
        raise QueryError(
            f"origins and directions must have shapes that broadcast against each other, "
            f"not {origins.shape} and {directions.shape}"
        ) from None
    limits = _read_limits(t_min, "t_min", shape, 0.0), _read_limits(t_max, "t_max", shape)
    masks = None if mask is None else read_masks(mask, shape)
    vectors = Broadcast.to_shape(origins, 1, shape), Broadcast.to_shape(directions, 1, shape)
    return RayBatch(*vectors, *limits, masks), shape


def read_vectors(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return (..., 3) float32 or float64."""
    vectors = _read_numbers(values, name)
    if vectors.dtype not in (np.float32, np.float64):
        with np.errstate(over="ignore"):  # of a wider dtype; what is not finite is refused later, by its index
            vectors = vectors.astype(np.float64)
    if vectors.shape == (0,):  # an empty list
        vectors = vectors.reshape(0, 3)
    if vectors.ndim == 0 or vectors.shape[-1] != 3:
        raise QueryError(f"{name} must have shape (3,), (n, 3) or (..., 3), not {vectors.shape}")
    return vectors


def read_points(points: ArrayLike) -> Broadcast:
    """Return points of any leading shape, without a copy where possible."""
    vectors = read_vectors(points, "points")
    return Broadcast.to_shape(vectors, 1, vectors.shape[:-1])


def _read_numbers(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return an array of real numbers, of any dtype for them."""
    try:
        numbers = np.asarray(values)
        if numbers.dtype == object:
            numbers = numbers.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise QueryError(f"{name} must be numbers: {error}") from error
    if has_masked_values(values):
        raise QueryError(f"{name} must be numbers, but some are masked: fill them, or leave them out")
    if numbers.dtype.kind not in "iuf":
        raise QueryError(f"{name} must be numbers, not {numbers.dtype}")
    return numbers


def read_lengths(values: ArrayLike, name: str, shape: tuple[int, ...]) -> Broadcast:
    """Return lengths of rays from points of this leading shape; infinity is allowed."""
    return _read_limits(values, name, shape, 0.0, "points")


def _read_limits(
    values: ArrayLike, name: str, shape: tuple[int, ...], least: float = -np.inf, subject_name: str = "rays"
) -> Broadcast:
    """Return a limit of rays of this leading shape; infinity is allowed."""
    if type(values) is float and values >= least:  # in a tenth of the time, which matters for a single ray
        return Broadcast.of_one(np.array([values]), shape)
    limits = _read_numbers(values, name).astype(np.float64, copy=False)
    if limits.shape and limits.shape != shape and not _fits(limits.shape, shape):
        raise QueryError(
            f"{name} must be a number or have a shape that broadcasts to that of the {subject_name}, {shape}, "
            f"not {limits.shape}"
        )
    # Written so that NaN is bad.
    if not (limits >= least).all():
        wrong = limits.flat[np.argmin(limits >= least)]
        index = np.unravel_index(np.argmin(limits >= least), limits.shape)
        subject = f"{name}[{', '.join(map(str, index))}]" if limits.shape else name
        wanted = "a number" if least == -np.inf else f"a number from {least:g}"
        raise QueryError(f"{subject} must be {wanted}, not {wrong}")
    return Broadcast.to_shape(limits, 0, shape)


def read_masks(values: ArrayLike, shape: tuple[int, ...], subject: str = "rays") -> Broadcast:
    """Return the masks of rays or points of this leading shape."""
    masks = _read_numbers(values, "mask")
    if masks.dtype.kind not in "iu":
        raise QueryError(f"mask must be integers, not {masks.dtype}")
    if masks.shape and masks.shape != shape and not _fits(masks.shape, shape):
        raise QueryError(
            f"mask must be a number or have a shape that broadcasts to that of the {subject}, {shape}, "
            f"not {masks.shape}"
        )
    if masks.size and not (int(masks.min()) >= 0 and int(masks.max()) <= _MOST_MASK):
        raise QueryError(f"mask must be from 0 to {_MOST_MASK:#x}, which has 32 bits")
    return Broadcast.to_shape(masks.astype(np.uint32), 0, shape)


def _fits(given: tuple[int, ...], shape: tuple[int, ...]) -> bool:
    """Say whether an array of one shape can be broadcast to the other."""
    lengths = zip(given[::-1], shape[::-1], strict=False)
    return len(given) <= len(shape) and all(length in (1, wanted) for length, wanted in lengths)


def too_far(subject: str, value: NDArray[Any]) -> QueryError:
    """Return the error for an origin or a point whose local coordinates are beyond float64."""
    return QueryError(
        f"{subject} is too far from the mesh: float64 cannot hold the distance in sizes of the mesh: {value}"
    )
