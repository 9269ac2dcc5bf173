"""The public function for ambient occlusion: one call that opens a tracer, unless there is one."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..device.info import DeviceInfo
from ..errors import ConfigError
from .rays.pieces import Progress
from .tracer import Traceable, Tracer


def ambient_occlusion(
    source: Traceable | Tracer,
    points: ArrayLike,
    normals: ArrayLike,
    *,
    rays: int = 64,
    max_distance: ArrayLike = np.inf,
    seed: int = 0,
    offset: float = 0.0,
    mask: ArrayLike | None = None,
    device: DeviceInfo | str | int | None = None,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Return how open the surroundings of each point are: 1 under a free sky, 0 where every way out is blocked.

    Parameters
    ----------
    source : Tracer, Scene, Bvh, or Mesh, trimesh.Trimesh, str, path or (vertices, faces)
        Anything that a `Tracer` is made of, which is opened for this call; or a tracer, which stays open.
    points, normals, rays, max_distance, seed, offset, mask, progress
        As of `Tracer.ambient_occlusion`.
    device : DeviceInfo, str, int or None
        As of `Tracer`; not together with a tracer.

    Returns
    -------
    (...,) float64
        From 0 to 1, in the shape that points and normals are broadcast to.

    Raises
    ------
    ConfigError
        A tracer and a device are given, or rays or seed is out of range.
    QueryError, DeviceError, MeshError
        As of `Tracer` and `Tracer.ambient_occlusion`.

    Examples
    --------
    The lower half of a sphere, its lowest point, above and below the surface:

    >>> import clbvh
    >>> import trimesh
    >>> ball = trimesh.creation.icosphere(subdivisions=4)
    >>> bowl = ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0]
    >>> clbvh.ambient_occlusion(bowl, [0, 0, -1], [[0, 0, 1], [0, 0, -1]], rays=1024).round(2)
    array([0.5, 1. ])
    """
    if isinstance(source, Tracer) and device is not None:
        raise ConfigError("device is that of the tracer: leave it out, or give what the tracer was made of")
    with nullcontext(source) if isinstance(source, Tracer) else Tracer(source, device=device) as tracer:
        return tracer.ambient_occlusion(
            points, normals, rays=rays, max_distance=max_distance, seed=seed, offset=offset, mask=mask,
            progress=progress,
        )  # fmt: skip
