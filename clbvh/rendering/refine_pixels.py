"""The hits of a picture in float64: those of the device are computed again, as those of every query are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from ..support.host_threads import HostThreads
from ..trace.hits.hits import Hits
from ..trace.hits.refine import HitIds, RefinedHits, refine_closest
from ..trace.hits.surface import SceneSurface
from ..trace.rays.batch import RayBatch, read_rays
from ..trace.triangles import triangles_of
from .camera import Camera
from .cut import Cut

# Pixels whose rays are in memory at a time: 48 MiB of origins and directions.
_CHUNK_PIXELS = 1 << 20


def refine_pixels(mesh: Mesh | SceneSurface, camera: Camera, found: NDArray[np.void], cut: Cut | None = None) -> Hits:
    """Return the hits of a picture in float64, on the primitives that the device found.

    Parameters
    ----------
    mesh : Mesh or SceneSurface
        What the picture shows.
    camera : Camera
    found : (height, width) `structs.HIT`, or `structs.SCENE_HIT` for a scene
    cut : Cut, optional
        What the picture does not show: t is moved out of it by what the device has rounded.

    Returns
    -------
    Hits
        Each (height, width); the rays are those of `Camera.rays`.
    """
    height, width = found.shape
    has_instances = not isinstance(mesh, Mesh)
    refined, ids = RefinedHits.make(height * width), HitIds.make(height * width, has_instances=has_instances)
    surface = triangles_of(mesh) if isinstance(mesh, Mesh) else mesh.arrays
    row_count = max(1, _CHUNK_PIXELS // width)
    with HostThreads() as threads:
        for first_row in range(0, height, row_count):
            last_row = min(first_row + row_count, height)
            origins, directions = camera.rays(width, height, range(first_row, last_row))
            rays, _ = read_rays(origins, directions, 0.0, np.inf)
            of_rows = found[first_row:last_row].reshape(-1)

            def refine(
                begin: int,
                end: int,
                first: int = first_row * width,
                batch: RayBatch = rays,
                of_rows: NDArray[np.void] = of_rows,
            ) -> None:
                pixels = first + begin, first + end
                refine_closest(
                    batch.part(begin, end), surface, of_rows[begin:end], refined.part(*pixels), ids.part(*pixels)
                )

            threads.for_ranges(len(of_rows), refine)
            if cut is not None:
                t = refined.t[first_row * width : last_row * width]
                t[:] = cut.limit(t.reshape(-1, width), origins, directions).reshape(-1)
    if isinstance(mesh, Mesh):
        return refined.as_hits(ids, (height, width), mesh=mesh)
    return refined.as_hits(ids, (height, width), mesh=None, scene_surface=mesh)
