"""Rays in numpy arrays go to the device, hits come back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..closing import Closing
from ..device.program import build_kernel
from ..device.select import DeviceInfo
from ..device.session import DeviceSession
from ..layout import HIT, RAY
from ..tree import Bvh
from .device_tree import DeviceTree, check_layout
from .hits import Hits

# Rays per kernel launch: 192 MiB of rays and hits on the device, whatever the size of the batch.
CHUNK_RAYS = 2**22

# Work-items per work-group. Small groups balance better on CPUs; GPUs run at least one whole warp or wavefront.
_GROUP_SIZE = 64

# Directions outside of these lengths are scaled by a power of two: their squares would not fit float32.
_SHORT, _LONG = 2.0**-40, 2.0**40


class Tracer(Closing):
    """Casts rays at one tree on one device; a context manager.

    Parameters
    ----------
    bvh : Bvh
    device : DeviceInfo, str, int or None
        The device: a number, part of its name, ``"gpu"`` or ``"cpu"``; without it a GPU, if there is one.
    layout : str
        ``"auto"`` or ``"bvh2"``.

    Raises
    ------
    DeviceError
        There is no such device, or the tree does not fit it.
    ConfigError
        An unknown layout.
    """

    def __init__(self, bvh: Bvh, *, device: DeviceInfo | str | int | None = None, layout: str = "auto") -> None:
        check_layout(layout)
        self._mesh = bvh.mesh
        self._session = DeviceSession(device)
        try:
            self._tree = DeviceTree(self._session, bvh.mesh, bvh, layout)
        except BaseException:
            self._session.close()
            raise
        self._kernels: dict[str, Any] = {}

    def closest_hit(
        self, origins: ArrayLike, directions: ArrayLike, *, t_min: ArrayLike = 0.0, t_max: ArrayLike = np.inf
    ) -> Hits:
        """Return the nearest crossing of each ray with the mesh, from either side of the triangles.

        Parameters
        ----------
        origins : (n, 3) float, the file's coordinates
        directions : (n, 3) float, any length above 0
        t_min, t_max : float or (n,) float, lengths of the direction
            Only crossings with t_min <= t <= t_max count; t_min is at least 0.

        Returns
        -------
        Hits
            With n entries. At equal distance the smaller face number wins.

        Raises
        ------
        ValueError
            Wrong shape, a value that is not finite, a direction of length zero, a negative t_min: the message names
            the first bad row. Or the tracer is closed.
        """
        return Hits.from_device(self._cast("closest_hit", HIT, origins, directions, t_min, t_max))

    def any_hit(
        self, origins: ArrayLike, directions: ArrayLike, *, t_min: ArrayLike = 0.0, t_max: ArrayLike = np.inf
    ) -> NDArray[np.bool_]:
        """Return (n,) bool: whether anything lies on each ray, which is cheaper to find out than what is nearest.

        Takes and raises the same as `closest_hit`.
        """
        return self._cast("any_hit", np.dtype(np.uint8), origins, directions, t_min, t_max).astype(bool)

    @property
    def layout(self) -> str:
        """The layout that the tree has on the device."""
        return self._tree.layout

    @property
    def memory_bytes(self) -> int:
        """Device memory that the tree and the triangles take."""
        return self._tree.memory_bytes

    @property
    def timings_ms(self) -> dict[str, float]:
        """Milliseconds on the device so far: upload, kernel, download."""
        return self._session.times.sums_ms()

    def close(self) -> None:
        """Give the device's memory back."""
        self._session.close()

    def __repr__(self) -> str:
        return f"Tracer({self._mesh.name!r}, device={self._session.info.name!r}, layout={self.layout!r})"

    def _cast(
        self,
        query: str,
        result_type: np.dtype,
        origins: ArrayLike,
        directions: ArrayLike,
        t_min: ArrayLike,
        t_max: ArrayLike,
    ) -> NDArray[Any]:
        """Run one query over all rays, chunk by chunk."""
        if self._session.is_closed:
            raise ValueError("the tracer is closed: its tree is no longer on the device")
        rays, exponents = pack_rays(origins, directions, t_min, t_max, self._mesh.origin)
        if query not in self._kernels:
            self._kernels[query] = build_kernel(self._session, query, self._tree.defines)
        results = np.empty(len(rays), result_type)
        chunk_rays = min(len(rays), CHUNK_RAYS)
        ray_buffer = self._session.allocate(chunk_rays * RAY.itemsize, writable=False)
        result_buffer = self._session.allocate(chunk_rays * result_type.itemsize)
        try:
            for begin in range(0, len(rays), CHUNK_RAYS):
                chunk = rays[begin : begin + CHUNK_RAYS]
                self._session.write(ray_buffer, chunk)
                self._session.run(
                    self._kernels[query], (len(chunk),), (_GROUP_SIZE,),
                    *self._tree.arguments, ray_buffer, result_buffer, np.int32(len(chunk)),
                )  # fmt: skip
                self._session.download(result_buffer, results[begin : begin + len(chunk)])
        finally:
            self._session.release(ray_buffer)
            self._session.release(result_buffer)
        if exponents is not None and result_type == HIT:
            with np.errstate(over="ignore"):
                results["t"] = np.ldexp(results["t"], -exponents)
        return results


def pack_rays(
    origins: ArrayLike, directions: ArrayLike, t_min: ArrayLike, t_max: ArrayLike, mesh_origin: NDArray[np.float64]
) -> tuple[NDArray[np.void], NDArray[np.int32] | None]:
    """Check rays, re-base them to the mesh's origin in float64, and pack them for the device.

    Returns
    -------
    rays : (n,) `layout.RAY`
    exponents : (n,) int32 or None
        The directions were divided by 2 to these powers, so t must be, too; None when all were left alone.
    """
    start = _as_rows(origins, "origins")
    along = _as_rows(directions, "directions")
    if len(start) != len(along):
        raise ValueError(f"origins and directions must have equally many rows, not {len(start)} and {len(along)}")
    length = np.abs(along).max(axis=1, initial=0.0)
    if not (length > 0).all():
        raise ValueError(f"directions[{int(np.argmin(length > 0))}] has length zero")
    limits = [_as_limits(t_min, "t_min", len(start), 0.0), _as_limits(t_max, "t_max", len(start), -np.inf)]

    rays = np.empty(len(start), RAY)
    try:
        with np.errstate(over="raise"):
            np.subtract(start, mesh_origin, out=rays["origin"], dtype=np.float64, casting="same_kind")
    except FloatingPointError:
        row = int(np.argmax(np.abs(start - mesh_origin).max(axis=1) > np.finfo(np.float32).max))
        raise ValueError(f"origins[{row}] is too far from the mesh for float32: {start[row]}") from None

    # A direction of extreme length gets a moderate one; the others stay what they are.
    exponents = None
    extreme = (length < _SHORT) | (length > _LONG)
    with np.errstate(over="ignore"):  # a limit beyond float32 is none
        if extreme.any():
            exponents = np.where(extreme, np.frexp(length)[1], 0)
            along = np.ldexp(along, -exponents[:, None])
            limits = [np.ldexp(limit, exponents) for limit in limits]
        rays["direction"] = along
        rays["t_min"], rays["t_max"] = limits
    return rays, exponents


def _as_limits(values: ArrayLike, name: str, ray_count: int, least: float) -> NDArray[np.float64]:
    """Return a number, or one for each ray; infinity is allowed."""
    limits = np.asarray(values, np.float64)
    if limits.shape not in ((), (ray_count,)):
        raise ValueError(f"{name} must be a number or have shape ({ray_count},), not {limits.shape}")
    bad = ~(limits >= least)  # written so that NaN is bad
    if bad.any():
        row = int(np.argmax(bad))
        place = f"{name}[{row}]" if limits.shape else name
        wanted = "a number" if least == -np.inf else f"a number from {least:g}"
        raise ValueError(f"{place} must be {wanted}, not {limits.flat[row]}")
    return limits


def _as_rows(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return (n, 3) finite floats."""
    rows = np.asarray(values)
    if rows.dtype not in (np.float32, np.float64):
        rows = rows.astype(np.float64)
    if rows.size == 0 and rows.ndim < 2:
        rows = rows.reshape(0, 3)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise ValueError(f"{name} must have shape (n, 3), not {rows.shape}")
    finite = np.isfinite(rows).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise ValueError(f"{name}[{row}] is not finite: {rows[row]}")
    return rows
