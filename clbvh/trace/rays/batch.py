"""Rays and points as the user gives them: read, with their shapes checked and their values not yet."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...errors import QueryError


class RayBatch(NamedTuple):
    """Rays in the file's coordinates.

    Attributes
    ----------
    origins, directions : (n, 3) float32 or float64
    t_min, t_max : (n,) or (1,) float64
        Limits, in lengths of the direction; one for all rays, or one for each.
    """

    origins: NDArray[Any]
    directions: NDArray[Any]
    t_min: NDArray[np.float64]
    t_max: NDArray[np.float64]

    @property
    def ray_count(self) -> int:
        """Number of rays."""
        return len(self.origins)

    def take(self, ray_ids: NDArray[np.integer]) -> RayBatch:
        """Return some of the rays, by their indices."""
        return RayBatch(
            self.origins[ray_ids],
            self.directions[ray_ids],
            self.t_min if len(self.t_min) == 1 else self.t_min[ray_ids],
            self.t_max if len(self.t_max) == 1 else self.t_max[ray_ids],
        )

    def part(self, begin: int, end: int) -> RayBatch:
        """Return rays `begin` to `end` in contiguous arrays of one dtype, as compiled functions take them."""
        dtype = np.result_type(self.origins, self.directions)
        return RayBatch(
            np.ascontiguousarray(self.origins[begin:end], dtype),
            np.ascontiguousarray(self.directions[begin:end], dtype),
            self.t_min if len(self.t_min) == 1 else self.t_min[begin:end],
            self.t_max if len(self.t_max) == 1 else self.t_max[begin:end],
        )


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
    origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike
) -> tuple[RayBatch, tuple[int, ...]]:
    """Return rays of any leading shape as a batch, without a copy where possible, and that shape.

    Raises
    ------
    QueryError
        A wrong shape, or a limit that is a wrong number.
    """
    origins, directions = read_vectors(origins, "origins"), read_vectors(directions, "directions")
    if origins.shape != directions.shape:
        raise QueryError(f"origins and directions must have one shape, not {origins.shape} and {directions.shape}")
    shape = origins.shape[:-1]
    limits = _read_limits(t_min, "t_min", shape), _read_limits(t_max, "t_max", shape)
    return RayBatch(origins.reshape(-1, 3), directions.reshape(-1, 3), *limits), shape


def read_vectors(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return (..., 3) float32 or float64."""
    vectors = _read_numbers(values, name)
    if vectors.dtype not in (np.float32, np.float64):
        with np.errstate(over="ignore"):  # of a wider dtype; what is not finite is refused later, by its index
            vectors = vectors.astype(np.float64)
    if vectors.size == 0 and vectors.ndim < 2:
        vectors = vectors.reshape(0, 3)
    if vectors.ndim < 2 or vectors.shape[-1] != 3:
        raise QueryError(f"{name} must have shape (n, 3) or (..., n, 3), not {vectors.shape}")
    return vectors


def _read_numbers(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return an array of real numbers, of any dtype for them."""
    try:
        numbers = np.asarray(values)
        if numbers.dtype == object:
            numbers = numbers.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise QueryError(f"{name} must be numbers: {error}") from error
    if numbers.dtype.kind not in "iuf":
        raise QueryError(f"{name} must be numbers, not {numbers.dtype}")
    return numbers


def _read_limits(values: ArrayLike, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return one limit as (1,), or one for each ray as (n,); infinity is allowed."""
    limits = _read_numbers(values, name).astype(np.float64, copy=False)
    if limits.shape not in ((), shape):
        raise QueryError(f"{name} must be a number or have shape {shape}, not {limits.shape}")
    least = 0.0 if name == "t_min" else -np.inf
    # Written so that NaN is bad. One number is compared without numpy, which matters for a single ray.
    is_good = limits.item() >= least if limits.ndim == 0 else bool((limits >= least).all())
    if not is_good:
        index = int(np.argmin(limits >= least))
        subject = f"{name}[{index_text(index, shape)}]" if limits.shape else name
        wanted = "a number" if least == -np.inf else f"a number from {least:g}"
        raise QueryError(f"{subject} must be {wanted}, not {limits.flat[index]}")
    return limits.reshape(-1)


def too_far(name: str, index: str, value: NDArray[Any]) -> QueryError:
    """Return the error for an origin or a point whose local coordinates are beyond float64."""
    return QueryError(
        f"{name}[{index}] is too far from the mesh: float64 cannot hold the distance in sizes of the mesh: {value}"
    )


def index_text(index: int, shape: tuple[int, ...]) -> str:
    """Return how a user would index an element of an array of this shape, given its number in C order."""
    return ", ".join(map(str, np.unravel_index(index, shape))) if math.prod(shape) > index else str(index)
