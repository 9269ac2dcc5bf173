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

from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..files.image_files import encode_picture, write_picture
from ..geometry import Mesh
from ..structs import NO_PRIM
from ..support.host_threads import HostThreads
from ..trace.hits.hits import Hits
from ..trace.hits.refine import RefinedHits, refine_closest
from ..trace.hits.surface import Surface
from ..trace.rays.batch import read_rays
from ..views.cameras.camera import Camera
from ..views.cut import Cut
from .drawn_scene import DrawnScene


@dataclass(frozen=True, eq=False, repr=False)
class Picture:
    """A rendered scene. A notebook shows it.

    Attributes
    ----------
    rgb : (height, width, 3) uint8
        The pixels; row 0 is the top.
    alpha : (height, width) uint8
        255 where every sample hits something, 0 where none does. In a transparent picture also the shadow on the
        ground, and `rgb` is the colour of the covered share alone.
    samples : int
        Of each pixel; in the mean, where the noise decides.
    found : (height, width) `structs.HIT`
        The device's hits through the centres of the pixels, in float32; t in local units.
    camera : Camera
        The camera of the picture.
    scene : DrawnScene
        What the picture shows; for the package itself.
    device : DeviceInfo
    layout : str
    workers : int
        Threads that built the tree; 0 when it came from the cache or was given.
    timings : dict of str to float
        Milliseconds: load, cache (look the tree up, keep it), build, open (the device), layout (arrange the tree for
        the device), compile (the kernels, or load those that an earlier run has compiled), upload, kernel, download
        (the device's own times), other (between these phases), and total: the wall time, the sum of all. In a first
        run each phase includes the compilation of its host functions. In a picture of a `Renderer`, the phases of its
        set-up are 0: see `Renderer.timings`.
    is_transparent : bool
        Whether the background is left out.
    tree_from_cache : bool
        Whether the tree came from the cache.
    notes : tuple of str
        Facts that a user should know but that are no errors.
    validated_pixels : int
        The number of pixels that were compared with the reference.
    cut : Cut or None
        What the picture does not show; see `View.cut`.
    film : (height, width, 4) float32 or None
        Linear red, green and blue before exposure and tone curve, and the covered share: the means of the samples. Only
        of a picture that was asked to keep it, in a shading with samples. The colours of a transparent picture are
        those before a black background.

    Examples
    --------
    >>> import clbvh
    >>> picture = clbvh.render(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
    >>> picture
    Picture(64 x 48 of 'icosphere', 1,565 pixels hit)

    numpy, matplotlib's `imshow` and others that take arrays see its `pixels`:

    >>> import numpy as np
    >>> np.asarray(picture).shape
    (48, 64, 3)
    """

    rgb: NDArray[np.uint8]
    alpha: NDArray[np.uint8]
    samples: int
    found: NDArray[np.void]
    camera: Camera
    scene: DrawnScene
    device: DeviceInfo
    layout: str
    workers: int
    timings: dict[str, float]
    is_transparent: bool = False
    tree_from_cache: bool = False
    notes: tuple[str, ...] = ()
    validated_pixels: int = 0
    film: NDArray[np.float32] | None = None
    cut: Cut | None = None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the picture to a file, ``.png``, ``.jpg`` or ``.ppm`` by its name: completely or not at all.

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
        write_picture(path, self.pixels)

    def to_pil(self) -> Any:
        """Return a `PIL.Image.Image` of the pixels, a copy.

        Examples
        --------
        >>> import clbvh
        >>> picture = clbvh.render(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
        >>> picture.to_pil().resize((32, 24)).size
        (32, 24)
        """
        from PIL import Image

        return Image.fromarray(self.pixels)

    def show(self) -> None:
        """Open the picture in the desktop's viewer, by way of `PIL.Image.Image.show`.

        Examples
        --------
        >>> import clbvh
        >>> picture = clbvh.render(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
        >>> picture.show()  # doctest: +SKIP
        """
        self.to_pil().show()

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return `pixels`, so that a picture can be given for an array."""
        return np.array(self.pixels, dtype, copy=copy)

    def _repr_png_(self) -> bytes:
        """Return the picture as PNG, for notebooks."""
        return encode_picture(self.pixels, ".png")

    def __repr__(self) -> str:
        height, width = self.found.shape
        return f"Picture({width} x {height} of {self.name!r}, {self._hit_count:,} pixels hit)"

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """(height, width, 3) uint8; of a transparent picture (height, width, 4), with `alpha`."""
        return np.dstack((self.rgb, self.alpha)) if self.is_transparent else self.rgb

    @cached_property
    def hits(self) -> Hits:
        """Hits of (height, width): t in the scene's unit from the eye, prim_id in the face order of the mesh's file.

        In a scene, also the `geometry_id` and the `instance_id` of each.

        Computed on first use, in float64: 0.2 s for Full HD on a 2-core x86-64 server, most of it for the rays.
        """
        return refine_pixels(self.scene.surface, self.camera, self.found, self.cut)

    @cached_property
    def depth(self) -> NDArray[np.float64]:
        """(height, width) float64: the distance of each hit along the optical axis, infinite on a miss.

        The z of depth cameras; the t of `hits` is the distance from the eye. See `Camera.cosines`.
        """
        height, width = self.found.shape
        return self.hits.t * self.camera.cosines(width, height)

    @property
    def mesh(self) -> Mesh | None:
        """The mesh, in the scene's coordinates; None in a picture of several objects."""
        return self.scene.mesh

    @property
    def bvh(self) -> Bvh | None:
        """The tree of the mesh; None without a tree, and in a picture of several objects."""
        return self.scene.bvh

    @property
    def name(self) -> str:
        """The name of the mesh, or of what a picture of several objects shows."""
        return self.scene.name

    @property
    def _hit_count(self) -> int:
        return int(np.count_nonzero(self.found["prim_id"] != NO_PRIM))

    def report(self) -> dict[str, Any]:
        """Return the numbers of the run, for a table or for JSON.

        A picture of several objects has more of them: geometries, instances, spheres, and placed_primitives, the sum
        over all instances. Its triangles and nodes are those in memory, each geometry once.

        Examples
        --------
        >>> import clbvh
        >>> report = clbvh.render(clbvh.make_shape("knot", triangles=20_000)).report()
        >>> report["rays"], 0 < report["hits"] < report["rays"]
        (360000, True)
        """
        rays = self.found.size
        return {
            **self.scene.report(),
            "tree_from_cache": self.tree_from_cache,
            "workers": self.workers,
            "device": self.device.name,
            "layout": self.layout,
            "width": self.rgb.shape[1],
            "height": self.rgb.shape[0],
            "samples": self.samples,
            "rays": rays,
            "hits": self._hit_count,
            "mrays_per_s": rays * self.samples / 1e3 / self.timings["kernel"],
            "validated_pixels": self.validated_pixels,
            "timings_ms": dict(self.timings),
        }


# Pixels whose rays are in memory at a time: 48 MiB of origins and directions.
_CHUNK_PIXELS = 1 << 20


def refine_pixels(surface: Surface, camera: Camera, found: NDArray[np.void], cut: Cut | None = None) -> Hits:
    """Return the hits of a picture in float64, on the primitives that the device found.

    Parameters
    ----------
    surface : Surface
        What the picture shows.
    camera : Camera
    found : (height, width) `structs.HIT`, or `structs.WORLD_HIT` for a scene
    cut : Cut, optional
        What the picture does not show: t is moved out of it by what the device has rounded.

    Returns
    -------
    Hits
        Each (height, width); the rays are those of `Camera.rays`.
    """
    height, width = found.shape
    refined = RefinedHits.make(height * width, is_lone=surface.arrays.is_lone)
    row_count = max(1, _CHUNK_PIXELS // width)
    with HostThreads() as threads:
        for first_row in range(0, height, row_count):
            last_row = min(first_row + row_count, height)
            origins, directions = camera.rays(width, height, range(first_row, last_row))
            batch, pixels = read_rays(origins, directions, 0.0, np.inf), (first_row * width, last_row * width)
            of_rows, hits = found[first_row:last_row].reshape(-1), refined.part(*pixels)

            def refine(
                begin: int, end: int, batch: Any = batch, of_rows: Any = of_rows, hits: RefinedHits = hits
            ) -> None:
                refine_closest(batch, begin, surface.arrays, of_rows[begin:end], hits.part(begin, end))

            threads.for_ranges(pixels[1] - pixels[0], refine)
            if cut is not None:
                t = refined.t[slice(*pixels)]
                t[:] = cut.limit(t.reshape(-1, width), origins, directions).reshape(-1)
    return refined.reshape(height, width).as_hits(surface)
