"""Arrays as callers give them, checked one step at a time: an error names the first fault.

Owns the steps that meshes and spheres share. Must not know of either.
"""

from __future__ import annotations

import sys
from threading import Lock
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ClbvhError, MeshError

# PoCL 3.0 ends the oldest mapping at an address, be it one that another thread has only begun: one begins at a time.
_mapping = Lock()

# Devices of DLPack whose memory the host reads: its own, and what CUDA and ROCm have pinned there.
_HOST_MEMORY = (1, 3, 11)


def is_device_array(thing: object) -> TypeGuard[Any]:
    """Return whether this is a `pyopencl.array.Array`; without that module nothing is."""
    module = sys.modules.get("pyopencl.array")
    return module is not None and isinstance(thing, module.Array)


def on_host(values: Any) -> Any:
    """Return what numpy can read: of device arrays and those with `__dlpack__` a numpy array, of a table its x, y, z.

    A table is a `pandas.DataFrame` or the like that has columns of these names. Anything else is returned as it is.

    Raises
    ------
    TypeError
        DLPack has it in the memory of a device, or numpy does not take it.
    """
    if is_device_array(values):
        return _map(values)
    if hasattr(values, "columns") and {"x", "y", "z"} <= set(values.columns):
        return values[["x", "y", "z"]]
    if isinstance(values, np.ndarray | np.generic) or not hasattr(values, "__dlpack__"):
        return values
    kind = int(values.__dlpack_device__()[0])
    if kind not in _HOST_MEMORY:
        raise TypeError(
            f"a {type(values).__name__} in the memory of a device (DLPack's type {kind}) is not read: copy it to the "
            "host, or into a pyopencl.array.Array"
        )
    try:
        return np.from_dlpack(values)
    except (BufferError, RuntimeError) as error:
        raise TypeError(str(error)) from error


def wait_for(array: Any) -> None:
    """Wait for the commands that write an array on a device.

    `Array.finish` forgets the events then, also those that another thread still waits for: a crash in the driver.

    Raises
    ------
    DeviceError
        This process was forked from one that has used OpenCL.
    """
    from ..device.context import check_process  # imported here: few arrays are on a device

    check_process()
    for event in list(array.events):
        event.wait()


def _map(array: Any) -> NDArray[Any]:
    """Return an array on a device as the host sees it: a CPU's memory is not copied."""
    cl = sys.modules["pyopencl"]
    wait_for(array)
    if array.size == 0 or not isinstance(array.base_data, cl.MemoryObjectHolder):
        return array.get()
    ways = [(length - 1) * stride for length, stride in zip(array.shape, array.strides, strict=True)]
    begin, end = (array.offset + sum(bound(way, 0) for way in ways) for bound in (min, max))
    size, queue = end - begin + array.dtype.itemsize, array.queue or cl.CommandQueue(array.context)
    # The host gives it back when nothing refers to it.
    with _mapping:
        mapped, _ = cl.enqueue_map_buffer(queue, array.base_data, cl.map_flags.READ, begin, size, np.uint8)
    return np.ndarray(array.shape, array.dtype, mapped, array.offset - begin, array.strides)


def as_array(values: ArrayLike, name: str, shape: str = "(n, 3)") -> NDArray[Any]:
    """Return values as an array; raise `MeshError` where they are none, or where some are masked; see `on_host`."""
    try:
        array = np.asarray(on_host(values))
    except ValueError as error:
        raise MeshError(f"{name} must be an array of shape {shape}, but the rows differ in length: {error}") from error
    except TypeError as error:
        raise MeshError(f"{name} must be an array of shape {shape}: {error}") from error
    if has_masked_values(values):
        raise MeshError(f"{name} must be numbers, but some are masked: fill them, or leave their rows out")
    return array


def check_numbers(array: NDArray[Any], name: str) -> None:
    """Raise `MeshError` unless the array's dtype is one of real numbers."""
    if not np.issubdtype(array.dtype, np.floating) and not np.issubdtype(array.dtype, np.integer):
        raise MeshError(f"{name} must be numbers, not {array.dtype}")


def read_numbers(values: ArrayLike, name: str, error: type[ClbvhError]) -> NDArray[Any]:
    """Return an array of real numbers, of any dtype for them, or raise the error."""
    try:
        numbers = np.asarray(on_host(values))
        if numbers.dtype == object:
            numbers = numbers.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as fault:
        raise error(f"{name} must be numbers: {fault}") from fault
    if has_masked_values(values):
        raise error(f"{name} must be numbers, but some are masked: fill them, or leave them out")
    if numbers.dtype.kind not in "iuf":
        raise error(f"{name} must be numbers, not {numbers.dtype}")
    return numbers


def copy_as_float64(array: NDArray[Any]) -> NDArray[np.float64]:
    """Return a copy in C order; what is no number in float64 becomes NaN or an infinity."""
    with np.errstate(over="ignore", invalid="ignore"):  # a wider dtype, a signalling NaN
        return np.array(array, np.float64, order="C")


def has_masked_values(values: object) -> bool:
    """Return whether a value is an array of `numpy.ma` with masked values; does not import that module."""
    module = sys.modules.get("numpy.ma")
    return (
        module is not None and isinstance(values, getattr(module, "MaskedArray", ())) and bool(module.is_masked(values))
    )
