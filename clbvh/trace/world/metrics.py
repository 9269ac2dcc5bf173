"""What distances within an instance need of its matrix, computed once for all points.

An instance's box is measured in rotated axes, in which its matrix is triangular (QR decomposition); a sphere becomes an
ellipsoid, whose axes are those of the singular value decomposition. See cl/nearest/metric.cl, which uses them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...device.session import DeviceSession
from ...kinds import TRIANGLES
from ...structs import METRIC
from .surface_arrays import SurfaceArrays

_ROUNDING = 2.0**-24

# A shear up to this share of the matrix, and half lengths that differ by this share, are what float32 leaves of a
# rotation. The slack of cl/nearest/metric.cl has room for them.
_LEAST_SHEAR = 8 * _ROUNDING
_EQUAL_SLACK = 16 * _ROUNDING


class Metrics(NamedTuple):
    """The metrics of all instances, in the order of their ids.

    Attributes
    ----------
    records : (n,) `structs.METRIC`
        As the device takes them.
    axes : (n, 3, 3) float64
        Of the ellipsoid that an instance makes of a sphere: unit vectors in the rows. Zero for an instance of a mesh.
    half_lengths : (n, 3) float64
        Along the axes, for a sphere of radius 1, in the world's units.
    """

    records: NDArray[np.void]
    axes: NDArray[np.float64]
    half_lengths: NDArray[np.float64]


class LazyMetrics:
    """The metrics of one world, made when points first ask for them: rays and moves need none."""

    def __init__(self, find_arrays: Callable[[], SurfaceArrays], scale: float) -> None:
        self._find_arrays, self._scale = find_arrays, scale
        self._buffer: Any = None

    # Two threads may make the same at once.
    @cached_property
    def metrics(self) -> Metrics:
        """The metrics."""
        return make_metrics(self._find_arrays(), self._scale)

    def put(self, owner: DeviceSession, session: DeviceSession) -> Any:
        """Return the buffer of the records, which the owner has."""
        buffer = self._buffer
        if buffer is None:
            records = self.metrics.records
            buffer = owner.allocate(records.nbytes, writable=False)
            session.write(buffer, records)
            self._buffer = buffer
        return buffer


def make_metrics(arrays: SurfaceArrays, scale: float) -> Metrics:
    """Return the metrics of the instances, given the local units of the world in one of its units."""
    own_scale = arrays.scale[arrays.geometry_id]
    # Between local coordinates: neither products nor float32 overflow.
    linear = arrays.linear / own_scale[:, None, None] * scale
    turn, triangular = np.linalg.qr(linear)
    signs = np.where(np.diagonal(triangular, axis1=1, axis2=2) < 0.0, -1.0, 1.0)
    triangular *= signs[:, :, None]
    reach = np.abs(linear).sum(axis=(1, 2))
    records = np.zeros(len(linear), METRIC)
    records["turn"] = signs[:, :, None] * turn.transpose(0, 2, 1)
    records["stretch"] = triangular[:, range(3), range(3)]
    records["shear"] = triangular[:, (0, 0, 1), (1, 2, 2)]
    records["is_sheared"] = np.abs(records["shear"]).max(axis=1) > _LEAST_SHEAR * reach
    records["reach"] = reach

    axes, half_lengths = np.zeros_like(linear), np.zeros((len(linear), 3))
    is_solid = arrays.kind[arrays.geometry_id] != TRIANGLES.number
    axes[is_solid], half_lengths[is_solid], _ = np.linalg.svd(linear[is_solid])
    axes = np.ascontiguousarray(axes.transpose(0, 2, 1))
    records["axes"], records["half_lengths"] = axes, half_lengths
    most, least = half_lengths[:, 0], half_lengths[:, 2]  # they are in descending order
    records["keeps_spheres"] = most - least <= _EQUAL_SLACK * most
    return Metrics(records, axes, half_lengths / scale * own_scale[:, None])
