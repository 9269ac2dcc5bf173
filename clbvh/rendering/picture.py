"""A rendered scene, and its hits in float64.

The colours are the device's, in float32. The hits are computed again in float64 like those of every query, when they
are first asked for: a picture that is only looked at does not pay for it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bvh import Bvh, sah_cost
from ..device.info import DeviceInfo
from ..geometry import Mesh
from ..structs import NO_PRIM
from ..support.host_threads import HostThreads
from ..trace.hits.hits import Hits
from ..trace.hits.refine import HitIds, RefinedHits, refine_closest
from ..trace.rays.batch import RayBatch, read_rays
from ..trace.triangles import triangles_of
from .camera import Camera
from .image_files import encode_picture, write_picture

# Pixels whose rays are in memory at a time: 48 MiB of origins and directions.
_CHUNK_PIXELS = 1 << 20


@dataclass(frozen=True, eq=False, repr=False)
class Picture:
    """A rendered scene. A notebook shows it.

    Attributes
    ----------
    rgb : (height, width, 3) uint8
        The pixels; row 0 is the top.
    found : (height, width) `structs.HIT`
        The device's hits, in float32; t in local units.
    camera : Camera
        The camera of the picture.
    mesh : Mesh
        In the scene's coordinates.
    bvh : Bvh or None
        None without a tree.
    device : DeviceInfo
    layout : str
    workers : int
        Processes that built the tree; 0 when it came from the cache or was given.
    timings : dict of str to float
        Milliseconds: load, pool_start (alongside other phases), cache (look the tree up, keep it), build, open (the
        device), layout (arrange the tree for the device), compile (functions and kernels, which are kept for the next
        run), load_code (those that were kept), upload, kernel, download (the device's own times), other (between these
        phases), and total: the wall time, the sum of all but pool_start. No other phase includes compile or load_code,
        which are those of all threads. In a picture of a `Renderer`, the phases of its set-up are 0: see
        `Renderer.timings`.
    tree_from_cache : bool
        Whether the tree came from the cache.
    notes : tuple of str
        Facts that a user should know but that are no errors.
    validated_pixels : int
        The number of pixels that were compared with the reference.

    Examples
    --------
    >>> import clbvh
    >>> picture = clbvh.render(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
    >>> picture
    Picture(64 x 48 of 'icosphere', 1,565 pixels hit)
    """

    rgb: NDArray[np.uint8]
    found: NDArray[np.void]
    camera: Camera
    mesh: Mesh
    bvh: Bvh | None
    device: DeviceInfo
    layout: str
    workers: int
    timings: dict[str, float]
    tree_from_cache: bool = False
    notes: tuple[str, ...] = ()
    validated_pixels: int = 0

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the picture to a file, ``.ppm`` or ``.png`` by its name: completely or not at all.

        Raises
        ------
        ConfigError
            The name has another suffix, or the file cannot be written.

        Examples
        --------
        >>> import clbvh
        >>> import tempfile
        >>> from pathlib import Path
        >>> picture = clbvh.render(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     picture.save(Path(folder, "sphere.png"))
        """
        write_picture(path, self.rgb)

    def _repr_png_(self) -> bytes:
        """Return the picture as PNG, for notebooks."""
        return encode_picture(self.rgb, ".png")

    def __repr__(self) -> str:
        height, width = self.found.shape
        return f"Picture({width} x {height} of {self.mesh.name!r}, {self._hit_count:,} pixels hit)"

    @cached_property
    def hits(self) -> Hits:
        """Hits of (height, width): t in the scene's unit from the eye, prim_id in the face order of the mesh's file.

        Computed on first use, in float64: 0.2 s for Full HD on a 2-core x86-64 server, most of it for the rays.
        """
        return refine_pixels(self.mesh, self.camera, self.found)

    @cached_property
    def depth(self) -> NDArray[np.float64]:
        """(height, width) float64: the distance of each hit along the optical axis, infinite on a miss.

        The z of depth cameras; the t of `hits` is the distance from the eye. See `Camera.cosines`.
        """
        height, width = self.found.shape
        return self.hits.t * self.camera.cosines(width, height)

    @property
    def _hit_count(self) -> int:
        return int(np.count_nonzero(self.found["prim_id"] != NO_PRIM))

    def report(self) -> dict[str, Any]:
        """Return the numbers of the run, for a table or for JSON.

        Examples
        --------
        >>> import clbvh
        >>> report = clbvh.render(clbvh.make_shape("knot", triangles=20_000)).report()
        >>> report["rays"], 0 < report["hits"] < report["rays"]
        (360000, True)
        """
        rays = self.found.size
        return {
            "mesh": self.mesh.name,
            "triangles": self.mesh.face_count,
            "degenerate_triangles": self.mesh.degenerate_count,
            "nodes": 0 if self.bvh is None else self.bvh.node_count,
            "depth": 0 if self.bvh is None else self.bvh.depth,
            "sah_cost": None if self.bvh is None else sah_cost(self.bvh),
            "tree_from_cache": self.tree_from_cache,
            "workers": self.workers,
            "device": self.device.name,
            "layout": self.layout,
            "width": self.rgb.shape[1],
            "height": self.rgb.shape[0],
            "rays": rays,
            "hits": self._hit_count,
            "mrays_per_s": rays / 1e3 / self.timings["kernel"],
            "validated_pixels": self.validated_pixels,
            "timings_ms": dict(self.timings),
        }


def refine_pixels(mesh: Mesh, camera: Camera, found: NDArray[np.void]) -> Hits:
    """Return the hits of a picture in float64, on the triangles that the device found.

    Parameters
    ----------
    mesh : Mesh
    camera : Camera
    found : (height, width) `structs.HIT`

    Returns
    -------
    Hits
        Each (height, width); the rays are those of `Camera.rays`.
    """
    height, width = found.shape
    refined, ids = RefinedHits.make(height * width), HitIds.make(height * width)
    triangles = triangles_of(mesh)
    row_count = max(1, _CHUNK_PIXELS // width)
    with HostThreads() as threads:
        for first_row in range(0, height, row_count):
            last_row = min(first_row + row_count, height)
            rays, _ = read_rays(*camera.rays(width, height, range(first_row, last_row)), 0.0, np.inf)
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
                    batch.part(begin, end), triangles, of_rows[begin:end], refined.part(*pixels), ids.part(*pixels)
                )

            threads.for_ranges(len(of_rows), refine)
    return refined.as_hits(ids, (height, width), mesh=mesh)
