"""Reads rays and points as the user gives them. Shapes are checked here, values when they are packed.

The host's kernels read the arrays where they are. Elsewhere, those that are broadcast to the shape of the rays are read
in C order part by part: no copy is as long as the rays.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...device.host.library import find_addresses
from ...errors import ConfigError, QueryError
from ...geometry.arrays import on_host, read_numbers
from ...scene.handles import shorten
from ...structs import NO_PRIM, WORLD_PRIM
from ...support.memory import check_memory

_FLOAT64 = np.dtype(np.float64)
_FLOATS = (np.dtype(np.float32), _FLOAT64)

_MOST_MASK = 0xFFFFFFFF

# The mask of rays that see every instance.
ALL_VISIBLE = np.array(_MOST_MASK, np.uint32)
ALL_VISIBLE.flags.writeable = False


# The sides of primitives that rays may see, by their numbers in cl/hits/search.cl.
SIDES = {None: 0, "front": 1, "back": 2}


def check_side(side: str | None) -> None:
    """Raise `ConfigError` unless this is a key of `SIDES`."""
    if not (side is None or isinstance(side, str)) or side not in SIDES:
        raise ConfigError(f"side must be 'front', 'back' or None, not {side!r}")


class RayArrays(NamedTuple):
    """The arrays of rays as the user gave them: of numpy, or those with vectors `pyopencl.array.Array`.

    Attributes
    ----------
    origins, directions : (..., 3) float32 or float64, the file's coordinates
        With any strides.
    t_min, t_max : (...,) float64, lengths of the direction
    mask : (...,) uint32
        The instances of a scene that are visible.
    """

    origins: Any
    directions: Any
    t_min: NDArray[np.float64]
    t_max: NDArray[np.float64]
    mask: NDArray[np.uint32]


class RayBatch:
    """Rays as the user gave them: kernels on the host read them where they are, others get parts of them.

    Parameters
    ----------
    arrays : RayArrays
    shape : tuple of int
        Leading shape that they are broadcast to.
    side : int
        Of primitives that they see, see `SIDES`.
    excluded : (ray_count,) `structs.WORLD_PRIM` or None
        The primitive that each ray does not see, in C order.

    Attributes
    ----------
    ray_count : int
    """

    def __init__(
        self, arrays: RayArrays, shape: tuple[int, ...], side: int = 0, excluded: NDArray[np.void] | None = None
    ) -> None:
        self.arrays, self.shape, self.ray_count = arrays, shape, math.prod(shape)
        self.side, self.excluded = side, excluded

    def limit_sight(self, side: str | None, exclude: Any, *, is_lone: bool) -> RayBatch:
        """Return the rays without what the user says that they do not see; see `Tracer.closest_hit`."""
        if side is None and exclude is None:
            return self
        check_side(side)
        excluded = None if exclude is None else _read_excluded(exclude, self.shape, is_lone=is_lone)
        return RayBatch(self.arrays, self.shape, SIDES[side], excluded)

    @property
    def is_on_device(self) -> bool:
        """Whether the vectors are in arrays on a device."""
        return not isinstance(self.arrays.origins, np.ndarray)

    @cached_property
    def rows(self) -> RowBatch:
        """The rays in the host's memory, part by part."""
        origins, directions, t_min, t_max, mask = self.arrays
        vectors = (Broadcast.to_shape(on_host(each), 1, self.shape) for each in (origins, directions))
        return RowBatch(*vectors, *(Broadcast.to_shape(each, 0, self.shape) for each in (t_min, t_max, mask)))

    def take(self, ray_ids: NDArray[np.integer]) -> RayBatch:
        """Return some of the rays, by their indices in C order."""
        arrays = RayArrays(*(values.take(ray_ids).items for values in self.rows))
        excluded = None if self.excluded is None else self.excluded[ray_ids]
        return RayBatch(arrays, (len(ray_ids),), self.side, excluded)

    @cached_property
    def axes(self) -> NDArray[np.int64]:
        """(n, 6) int64: where the host's kernels and loops find the rays, see cl/rays/arrays.cl."""
        origins, directions, t_min, t_max, mask = self.arrays
        return _make_axes(
            self.shape, origins.shape, origins.strides, directions.shape, directions.strides, t_min.shape,
            t_min.strides, t_max.shape, t_max.strides, mask.shape, mask.strides,
        )  # fmt: skip

    def device_axes(self, begin: int, parts: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
        """Return the same of vectors on a device, whose limits and masks are those of the rays from `begin` on."""
        origins, directions = self.arrays[:2]
        facts = [origins.shape, origins.strides, directions.shape, directions.strides]
        for each in parts:
            is_one = len(each) == 1
            facts += [(), ()] if is_one else [self.shape, _find_contiguous_strides(each.itemsize, self.shape)]
        axes = _make_axes(self.shape, *facts).copy()
        axes[0, :3] = begin, origins.offset, directions.offset
        axes[0, 3:] = [0 if len(each) == 1 else -begin * each.itemsize for each in parts]
        return axes

    @cached_property
    def addresses(self) -> NDArray[np.uint64]:
        """The same as the host's loops are told of it, see cl/rays/given.cl: a struct of addresses and numbers.

        Addresses are no references: the batch holds what they are of.
        """
        assert not self.is_on_device
        *arrays, axes_at = find_addresses((*self.arrays, self.axes))
        return np.array([*arrays, self.doubles, axes_at, len(self.axes) - 2], np.uint64)

    @property
    def doubles(self) -> int:
        """Which vectors are float64, see cl/rays/arrays.cl."""
        return (self.arrays.origins.dtype.itemsize == 8) + 2 * (self.arrays.directions.dtype.itemsize == 8)


def _find_contiguous_strides(item_bytes: int, shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(item_bytes * math.prod(shape[axis + 1 :]) for axis in range(len(shape)))


@lru_cache(maxsize=256)
def _make_axes(shape: tuple[int, ...], *facts: tuple[int, ...]) -> NDArray[np.int64]:
    """Return `RayBatch.axes`, given the shapes and strides of the arrays.

    Neighbouring axes are merged where every array steps evenly across both.
    """
    shapes, strides = [*facts[::2]], [*facts[1::2]]
    coordinates = [3, strides[0][-1], strides[1][-1], 0, 0, 0]
    for vectors in (0, 1):  # their last axis is that of the coordinates
        shapes[vectors], strides[vectors] = shapes[vectors][:-1], strides[vectors][:-1]
    columns = [_find_steps(own, steps, shape) for own, steps in zip(shapes, strides, strict=True)]
    rows: list[list[int]] = []
    for axis, length in enumerate(shape):
        row = [length, *(steps[axis] for steps in columns)]
        if rows and all(before == length * step for before, step in zip(rows[-1][1:], row[1:], strict=True)):
            row[0] *= rows.pop()[0]
        rows.append(row)
    axes = np.array([[0] * 6, coordinates, *(rows or [[1, 0, 0, 0, 0, 0]])], np.int64)
    axes.flags.writeable = False
    return axes


def find_point_axes(
    points: NDArray[Any], limits: NDArray[np.float64], masks: NDArray[np.uint32]
) -> NDArray[np.int64]:  # fmt: skip
    """Return the same of points, which have the place of origins, with the largest distances and masks."""
    none = (3,), (0,), (), ()  # of directions and t_min
    more = limits.shape, limits.strides, masks.shape, masks.strides
    return _make_axes(points.shape[:-1], points.shape, points.strides, *none, *more)


def _find_steps(own: tuple[int, ...], strides: tuple[int, ...], shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the bytes from one item to the next along each axis of the shape that an array is broadcast to."""
    steps = (0 if length == 1 else stride for length, stride in zip(own, strides, strict=True))
    return (*(0,) * (len(shape) - len(own)), *steps)


def find_origins(origins: Any, directions: ArrayLike) -> Any:
    """Return origins as they are; those of hits or closest points next to the surface, where each direction leads."""
    return origins.offset_origins(towards=directions) if hasattr(origins, "offset_origins") else origins


def read_rays(
    origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike, mask: ArrayLike | None = None
) -> RayBatch:
    """Return rays as a batch, without a copy where possible.

    Raises
    ------
    QueryError
        A wrong shape, shapes that do not broadcast, or a limit that is out of range.
    """
    return _make_batch(read_vectors(origins, "origins"), read_vectors(directions, "directions"), t_min, t_max, mask)


def read_unmasked_rays(
    origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike, mask: ArrayLike | None,
    read: Callable[..., RayBatch] = read_rays,
) -> RayBatch:  # fmt: skip
    """Return rays at a shape without instances, which every mask but 0 sees; errors are those of `read_rays`."""
    batch = read(origins, directions, t_min, t_max, mask)
    if mask is None:
        return batch
    t_max = np.where(np.asarray(on_host(mask)) == 0, -np.inf, on_host(t_max))
    return read(origins, directions, t_min, t_max)


def read_device_rays(
    origins: Any, directions: Any, t_min: ArrayLike, t_max: ArrayLike, mask: ArrayLike | None = None
) -> RayBatch:
    """Return rays whose vectors are on a device, float32 or float64; all else as `read_rays`."""
    _check_vectors(origins, "origins")
    _check_vectors(directions, "directions")
    return _make_batch(origins, directions, t_min, t_max, mask)


def _make_batch(origins: Any, directions: Any, t_min: ArrayLike, t_max: ArrayLike, mask: ArrayLike | None) -> RayBatch:
    shape = origins.shape[:-1]
    if shape != directions.shape[:-1]:
        shape = _ray_shape(origins, directions)
    limits = _read_limits(t_min, "t_min", shape, 0.0), _read_limits(t_max, "t_max", shape)
    masks = ALL_VISIBLE if mask is None else read_masks(mask, shape, "rays")
    return RayBatch(RayArrays(origins, directions, *limits, masks), shape)


class RowBatch(NamedTuple):
    """Rays in arrays of the host that are broadcast to one shape.

    Attributes
    ----------
    origins, directions : Broadcast of float32 or float64 vectors, the file's coordinates
    t_min, t_max : Broadcast of float64, lengths of the direction
    mask : Broadcast of uint32
    """

    origins: Broadcast
    directions: Broadcast
    t_min: Broadcast
    t_max: Broadcast
    mask: Broadcast


def _ray_shape(origins: Any, directions: Any) -> tuple[int, ...]:
    try:
        return broadcast_shape(origins.shape[:-1], directions.shape[:-1])
    except ValueError:
        raise QueryError(
            f"origins and directions must have shapes that broadcast against each other, "
            f"not {origins.shape} and {directions.shape}"
        ) from None


def read_vectors(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return (..., 3) float32 or float64, aligned."""
    # As many do: what follows would take a single ray a quarter of its time.
    if type(values) is np.ndarray and values.dtype in _FLOATS and values.flags.aligned and values.shape[-1:] == (3,):
        return values
    return _read_any_vectors(values, name)


def _check_vectors(vectors: Any, name: str) -> None:
    if vectors.ndim == 0 or vectors.shape[-1] != 3:
        raise QueryError(f"{name} must have shape (3,), (n, 3) or (..., 3), not {vectors.shape}")


def _read_any_vectors(values: ArrayLike, name: str) -> NDArray[Any]:
    vectors = read_numbers(values, name, QueryError)
    if vectors.dtype not in _FLOATS:
        with np.errstate(over="ignore"):  # of a wider dtype; what is not finite is refused later, by its index
            vectors = vectors.astype(np.float64)
    if vectors.shape == (0,):  # an empty list
        vectors = vectors.reshape(0, 3)
    _check_vectors(vectors, name)
    return vectors if vectors.flags.aligned else vectors.copy()


def read_lengths(values: ArrayLike, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return lengths of rays from points of this leading shape, or distances; infinity is allowed."""
    return _read_limits(values, name, shape, 0.0, "points")


def _read_limits(
    values: ArrayLike, name: str, shape: tuple[int, ...], least: float = -np.inf, subject_name: str = "rays"
) -> NDArray[np.float64]:
    """Return a limit of rays of this leading shape; infinity is allowed."""
    if type(values) is float and values >= least:  # in a tenth of the time, which matters for a single ray
        return _as_limit(values)
    numbers = read_numbers(values, name, QueryError)
    _check_fit(numbers, name, shape, subject_name)
    limits = _cut_repetitions(numbers, 0).astype(np.float64, copy=False)
    # Written so that NaN is bad.
    if not (limits >= least).all():
        wrong = limits.flat[np.argmin(limits >= least)]
        index = np.unravel_index(np.argmin(limits >= least), limits.shape)
        subject = f"{name}[{', '.join(map(str, index))}]" if limits.shape else name
        wanted = "a number" if least == -np.inf else f"a number from {least:g}"
        raise QueryError(f"{subject} must be {wanted}, not {wrong}")
    return limits if limits.flags.aligned else limits.copy()


@lru_cache(maxsize=64)
def _as_limit(value: float) -> NDArray[np.float64]:
    limit = np.array(value)
    limit.flags.writeable = False
    return limit


def read_masks(values: ArrayLike, shape: tuple[int, ...], subject: str) -> NDArray[np.uint32]:
    """Return the masks of rays or points, as messages call them, of this leading shape."""
    masks = read_numbers(values, "mask", QueryError)
    if masks.dtype.kind not in "iu":
        raise QueryError(f"mask must be integers, not {masks.dtype}")
    _check_fit(masks, "mask", shape, subject)
    masks = _cut_repetitions(masks, 0)
    if masks.size and not (int(masks.min()) >= 0 and int(masks.max()) <= _MOST_MASK):
        raise QueryError(f"mask must be from 0 to {_MOST_MASK:#x}, which has 32 bits")
    return masks.astype(np.uint32)


def _read_excluded(exclude: Any, shape: tuple[int, ...], *, is_lone: bool) -> NDArray[np.void]:
    """Return the primitive that each ray of a shape does not see, (n,) `structs.WORLD_PRIM`."""
    # Hits and closest points know the instances.
    if not (is_lone or hasattr(exclude, "instance_id")):
        raise QueryError("exclude must be hits or closest points in a scene: the number of a face is of many instances")
    prims = read_numbers(getattr(exclude, "prim_id", exclude), "exclude", QueryError)
    if prims.dtype.kind not in "iu" or (prims.size and not NO_PRIM <= prims.min() <= prims.max() < 2**31):
        raise QueryError(f"exclude must be hits, closest points or numbers of faces from -1, not {shorten(exclude)}")
    _check_fit(prims, "exclude", shape, "rays")
    excluded = np.zeros(shape, WORLD_PRIM)
    excluded["prim_id"], excluded["instance_id"] = prims, getattr(exclude, "instance_id", 0)
    return excluded.reshape(-1)


def _check_fit(values: NDArray[Any], name: str, shape: tuple[int, ...], subject: str) -> None:
    """Raise unless an array can be broadcast to a leading shape."""
    lengths = zip(values.shape[::-1], shape[::-1], strict=False)
    if values.ndim > len(shape) or not all(length in (1, wanted) for length, wanted in lengths):
        raise QueryError(
            f"{name} must be a number or have a shape that broadcasts to that of the {subject}, {shape}, "
            f"not {values.shape}"
        )


def _cut_repetitions(values: NDArray[Any], item_dims: int) -> NDArray[Any]:
    """Return an array whose axes have length 1 where the caller has broadcast them."""
    strides = values.strides[: values.ndim - item_dims]
    return values[tuple(slice(0, 1) if step == 0 else slice(None) for step in strides)] if 0 in strides else values


def too_far(subject: str, value: NDArray[Any]) -> QueryError:
    """Return the error for an origin or a point whose local coordinates are beyond float64."""
    return QueryError(
        f"{subject} is too far from the mesh: float64 cannot hold the distance in sizes of the mesh: {value}"
    )


# Vectors of float64 that an array can have.
_MOST_ITEMS = sys.maxsize // 24


class Broadcast(NamedTuple):
    """Items of an array, one for each element of a leading shape.

    Attributes
    ----------
    items : array
        One item for all elements, (1, ...); items in C order, (n, ...); or a view that has the leading shape. Aligned
        and read-only.
    is_one : bool
        Whether there is one item for all elements.
    is_flat : bool
        Whether the items have a single leading axis.
    given_shape : tuple of int
        Leading shape of the array as the user gave it.
    shape : tuple of int
        Leading shape that it is broadcast to.
    """

    items: NDArray[Any]
    is_one: bool
    is_flat: bool
    given_shape: tuple[int, ...]
    shape: tuple[int, ...]

    @classmethod
    def to_shape(cls, values: NDArray[Any], item_dims: int, shape: tuple[int, ...]) -> Broadcast:
        """Broadcast an array to a leading shape, which its own must fit; nothing is copied."""
        flags = values.flags
        is_flat = values.ndim == item_dims + 1
        # The fast path, for ordinary arrays. `flags.carray` would warn of results of `np.broadcast_arrays`.
        if is_flat and values.shape[:1] == shape and flags.c_contiguous and flags.aligned:
            return cls._of_items(values, item_dims, shape, shape)
        if not flags.aligned:  # loops need it
            values = values.copy()
        leading_dims = values.ndim - item_dims
        given_shape, item_shape = values.shape[:leading_dims], values.shape[leading_dims:]
        values = _cut_repetitions(values, item_dims)
        own_shape = values.shape[:leading_dims]
        if math.prod(own_shape) == 1:
            items = values.reshape(1, *item_shape)
        elif own_shape == shape and leading_dims == 1:
            items = values
        elif own_shape == shape and values.flags.c_contiguous:
            items = values.reshape(-1, *item_shape)
        else:
            items = np.broadcast_to(values, shape + item_shape)
        return cls._of_items(items, item_dims, given_shape, shape)

    @classmethod
    def _of_items(
        cls, items: NDArray[Any], item_dims: int, given_shape: tuple[int, ...], shape: tuple[int, ...]
    ) -> Broadcast:
        is_flat = items.ndim == item_dims + 1
        items = items.view()
        items.flags.writeable = False
        return cls(items, is_flat and len(items) == 1, is_flat, given_shape, shape)

    @property
    def is_contiguous(self) -> bool:
        """Whether parts are views, not copies."""
        return self.is_flat and self.items.flags.c_contiguous

    def part(self, begin: int, end: int, dtype: np.dtype[Any]) -> NDArray[Any]:
        """Return the items of elements `begin` to `end`, or the one for all, contiguous."""
        if self.is_flat:
            part = self.items if self.is_one else self.items[begin:end]
            if part.dtype == dtype and part.flags.c_contiguous:
                return part
            part = np.ascontiguousarray(part, dtype)
        else:
            part = np.empty((end - begin, *self.items.shape[len(self.shape) :]), dtype)
            _copy_range(self.items, len(self.shape), begin, end, part)
        return part

    def take(self, indices: NDArray[np.integer]) -> Broadcast:
        """Return the items of some elements, by their indices in C order."""
        if self.is_one:
            return self._replace(shape=(len(indices),))
        if self.is_contiguous:
            taken = self.items.take(indices, axis=0)  # in a third of the time
        else:
            taken = self.items[indices] if self.is_flat else self.items[np.unravel_index(indices, self.shape)]
        shape = (len(indices),)
        return self._of_items(taken, taken.ndim - 1, shape, shape)

    def subject(self, name: str, index: int) -> str:
        """Return the item of an element as messages name it, such as ``origins[3, 1]``, given its index in C order."""
        if not self.given_shape:
            return name
        if math.prod(self.shape) <= index:
            return f"{name}[{index}]"
        along = np.unravel_index(index, self.shape)[len(self.shape) - len(self.given_shape) :]
        own = (0 if length == 1 else at for length, at in zip(self.given_shape, along, strict=True))
        return f"{name}[{', '.join(map(str, own))}]"


def broadcast_shape(one: tuple[int, ...], other: tuple[int, ...]) -> tuple[int, ...]:
    """Return the leading shape that two are broadcast to.

    Raises
    ------
    ValueError
        They do not fit each other; they have more than 32 axes, unless they are the same; or no array is so large.
    """
    if one == other:
        return one
    try:
        shape = np.broadcast_shapes(one, other)
    except RuntimeError as error:
        raise ValueError(str(error)) from error
    # Axes of length 0 do not make numpy's views any smaller.
    if math.prod(max(length, 1) for length in shape) > _MOST_ITEMS:
        raise ValueError(f"no array has the shape {shape}")
    return shape


def _copy_range(grid: NDArray[Any], leading_dims: int, begin: int, end: int, target: NDArray[Any]) -> None:
    """Copy items `begin` to `end` of a grid, in C order: the end of a row, whole rows, and the beginning of a row."""
    if begin == end:
        return
    if leading_dims == 1:
        target[:] = grid[begin:end]
        return
    row_length = math.prod(grid.shape[1:leading_dims])
    first, last = -(-begin // row_length), end // row_length
    if last < first:
        _copy_range(grid[last], leading_dims - 1, begin - last * row_length, end - last * row_length, target)
        return
    head, tail = first * row_length - begin, end - last * row_length
    if head:
        _copy_range(grid[first - 1], leading_dims - 1, row_length - head, row_length, target[:head])
    target[head : len(target) - tail].reshape(last - first, *grid.shape[1:])[...] = grid[first:last]
    if tail:
        _copy_range(grid[last], leading_dims - 1, 0, tail, target[len(target) - tail :])


def check_room(count: int, bytes_of_each: int, subject: str = "rays") -> None:
    """Raise `QueryError` if the results of rays or points do not fit the free memory."""
    advice = f"ask for fewer {subject} at a time"
    check_memory(f"the results of {count:,} {subject}", count * bytes_of_each, QueryError, advice)
