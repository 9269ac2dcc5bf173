"""The whole way from a scene to a picture: load, build, upload, render. The one place that knows the order."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..build.builder import BUILDERS, leaf_limit
from ..build.options import MAX_DEPTH
from ..device.select import DeviceInfo
from ..device.session import DeviceSession
from ..errors import ConfigError, ValidationError
from ..geometry import Mesh
from ..stopwatch import Stopwatch
from ..trace.device_tree import BRUTE, DeviceTree, check_layout
from ..trace.hits import Hits
from ..trace.reference import find_differences
from ..tree import Bvh, sah_cost, validate_tree
from .camera import Camera
from .frame import FrameRenderer
from .scene import Scene
from .scene_file import open_scene
from .tree_maker import MadeTree, TreeMaker, TreeOptions
from .view import make_view

# Without a tree, cost is rays times triangles: above this many triangles that is no comparison but a hang.
BRUTE_LIMIT = 100_000

# Ray-triangle tests that a validation may spend: about a second.
_VALIDATION_TESTS = 50_000_000


@dataclass(frozen=True)
class RenderOptions(TreeOptions):
    """How to render a scene, apart from what it shows.

    Attributes
    ----------
    builder, workers, build, cache
        See `TreeOptions`. The builder may also be ``"brute"``: no tree.
    device : DeviceInfo, str, int or None
        See `choose_device`.
    layout : str
        Layout of the tree on the device, or ``"auto"``: what suits the device, and ``"bvh2"`` for the builder
        ``"frontier"``, since a wide layout cuts the large leaves that this builder is about.
    validate : bool
        Check the tree, and compare a sample of the pixels with the slow reference.
    """

    device: DeviceInfo | str | int | None = None
    layout: str = "auto"
    validate: bool = False

    allowed_builders: ClassVar[tuple[str, ...]] = (*BUILDERS, BRUTE)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_layout(self.layout)

    @property
    def chosen_layout(self) -> str:
        """`layout`, or ``"auto"`` where the device is to choose."""
        return "bvh2" if self.layout == "auto" and self.builder == "frontier" else self.layout


@dataclass(frozen=True, eq=False)
class Picture:
    """A rendered scene.

    Attributes
    ----------
    rgb : (height, width, 3) uint8
    hits : Hits
        Each (height, width); t in object units from the eye, prim_id in the face order of the mesh's file.
    camera : Camera
        Where the picture was taken from.
    mesh : Mesh
    bvh : Bvh or None
        None without a tree.
    device : DeviceInfo
    layout : str
    workers : int
        Processes that built the tree; 0 when it came from the cache.
    timings : dict of str to float
        Milliseconds: load, pool_start (overlaps with load), cache (look for the tree, or keep it), build, compile,
        upload, kernel, download, and total, the wall time of all of it. Upload, kernel and download are the device's
        own times.
    tree_from_cache : bool
        Whether the tree was taken from the cache.
    notes : tuple of str
        What a user should know and what is no error.
    validated_pixels : int
        How many pixels were compared with the reference.
    """

    rgb: NDArray[np.uint8]
    hits: Hits
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

    def report(self) -> dict[str, Any]:
        """Return the figures of the run, for a table or for JSON."""
        rays = self.hits.prim_id.size
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
            "hits": self.hits.count,
            "mrays_per_s": rays / 1e3 / self.timings["kernel"],
            "validated_pixels": self.validated_pixels,
            "timings_ms": dict(self.timings),
        }


def render(
    scene: Scene | str | os.PathLike[str],
    options: RenderOptions | None = None,
    *,
    on_phase: Callable[[str], None] = lambda phase: None,
) -> Picture:
    """Render a scene.

    Parameters
    ----------
    scene : Scene, str or path
        A scene, a scene file, or whatever else `open_scene` takes.
    options : RenderOptions, optional
    on_phase : function, optional
        Called with the name of each phase as it begins.

    Returns
    -------
    Picture

    Raises
    ------
    SceneError, MeshError, ConfigError
        The input cannot be used.
    DeviceError, KernelBuildError, PoolError
        The machine cannot do it.
    ValidationError
        The tree or a pixel is wrong.
    """
    if not isinstance(scene, Scene):
        scene = open_scene(scene)
    options = options or RenderOptions()
    watch = Stopwatch()
    with ExitStack() as stack:
        maker = None
        if options.builder != BRUTE:
            maker = stack.enter_context(TreeMaker(options, scene.mesh.estimate_face_count()))

        on_phase("load")
        mesh = scene.transform.apply(scene.mesh.load())
        camera = scene.camera(mesh)
        watch.lap("load")

        on_phase("build")
        made: MadeTree | None = None
        if maker is not None:
            made = maker.make(mesh)
        elif mesh.face_count > BRUTE_LIMIT:
            raise ConfigError(
                f"the brute builder tests every triangle for every ray: {mesh.face_count:,} triangles are more than "
                f"its limit of {BRUTE_LIMIT:,}"
            )
        bvh = None if made is None else made.bvh
        watch.lap("build")

        on_phase("compile")
        session = stack.enter_context(DeviceSession(options.device))
        watch.lap("open")
        tree = DeviceTree(session, mesh, bvh, options.chosen_layout)
        watch.lap("layout")
        renderer = FrameRenderer(session, tree)
        watch.lap("compile")

        on_phase("render")
        colours, device_hits = renderer.render(make_view(scene, camera, mesh))
        total_ms = watch.total_ms
        hits = Hits.from_device(device_hits, mesh)

        device_ms = session.times.sums_ms()
        timings = {
            "load": watch.laps_ms["load"],
            **(dict.fromkeys(("pool_start", "cache", "build"), 0.0) if made is None else made.timings_ms),
            "compile": watch.laps_ms["open"] + watch.laps_ms["compile"],
            "upload": device_ms["upload"],
            "kernel": device_ms["kernel"],
            "download": device_ms["download"],
            "total": total_ms,
        }
        validated = 0
        if options.validate:
            on_phase("validate")
            validated = _validate(mesh, bvh, camera, hits, options)
    return Picture(
        rgb=np.ascontiguousarray(colours[..., :3]),
        hits=hits,
        camera=camera,
        mesh=mesh,
        bvh=bvh,
        device=session.info,
        layout=tree.layout,
        workers=1 if made is None else made.workers,
        timings=timings,
        tree_from_cache=made is not None and made.from_cache,
        notes=() if made is None else made.notes,
        validated_pixels=validated,
    )


def _validate(mesh: Mesh, bvh: Bvh | None, camera: Camera, hits: Hits, options: RenderOptions) -> int:
    """Check the tree and a sample of the pixels; return how many pixels that was."""
    if bvh is not None:
        validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_limit(options.builder, options.build))
    height, width = hits.prim_id.shape
    pixel_count = min(width * height, max(1, _VALIDATION_TESTS // mesh.face_count))
    # Evenly spread over the picture, the same ones each time; all of them when they are few.
    pixels = np.linspace(0, width * height - 1, pixel_count).astype(np.int64)
    origins, directions = camera.rays(width, height)
    differences = find_differences(
        mesh, origins.reshape(-1, 3)[pixels] - mesh.origin, directions.reshape(-1, 3)[pixels], hits.take(pixels)
    )
    if differences:
        first = differences[0]
        row, column = divmod(int(pixels[first.ray]), width)
        raise ValidationError(
            f"{len(differences)} of {pixel_count} pixels differ from the reference; the first one is at column "
            f"{column}, row {row}: {first}"
        )
    return pixel_count
