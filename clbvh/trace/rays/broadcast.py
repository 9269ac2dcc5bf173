"""Arrays that are broadcast to the shape of the rays, and read in C order part by part: no copy is as long as the rays.

Owns how parts of broadcast and strided arrays become contiguous. Must not know what the arrays mean.
"""

from __future__ import annotations

import math
import sys
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
        if not flags.aligned:  # numba would compile one more version
            values = values.copy()
        leading_dims = values.ndim - item_dims
        given_shape, item_shape = values.shape[:leading_dims], values.shape[leading_dims:]
        # An axis that the caller has broadcast counts as one of length 1.
        if 0 in values.strides[:leading_dims]:
            values = values[tuple(slice(0, 1) if stride == 0 else slice(None) for stride in values.strides)]
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
    def of_one(cls, items: NDArray[Any], shape: tuple[int, ...]) -> Broadcast:
        """Broadcast the only item of an array, (1, ...), which becomes read-only."""
        items.flags.writeable = False
        return cls(items, True, True, (), shape)

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
        """Return the items of elements `begin` to `end`, or the one for all, contiguous and read-only.

        Read-only, because numba would compile another version of each function for writable arrays.
        """
        if self.is_flat:
            part = self.items if self.is_one else self.items[begin:end]
            if part.dtype == dtype and part.flags.c_contiguous:
                return part
            part = np.ascontiguousarray(part, dtype)
        else:
            part = np.empty((end - begin, *self.items.shape[len(self.shape) :]), dtype)
            _copy_range(self.items, len(self.shape), begin, end, part)
        part.flags.writeable = False
        return part

    def take(self, indices: NDArray[np.integer]) -> Broadcast:
        """Return the items of some elements, by their indices in C order."""
        if self.is_one:
            return self._replace(shape=(len(indices),))
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
