"""From a scene to a picture: load, build, open the device, render.

Owns the order of these steps and their timings; each step is another file's.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..builders.options import MAX_DEPTH
from ..builders.registry import BUILDERS, leaf_limit
from ..builders.tree_maker import MadeTree, TreeMaker, TreeOptions
from ..bvh import Bvh, validate_tree
from ..device.info import DeviceInfo
from ..device.session import DeviceSession
from ..errors import ConfigError, ValidationError
from ..geometry import Mesh
from ..support.stopwatch import Stopwatch, add_total
from ..trace.device_tree import BRUTE, DeviceTree, check_layout
from ..trace.hits.hits import Hits
from ..trace.oracle.reference import find_differences
from .camera import Camera
from .frame import FrameRenderer
from .picture import Picture
from .scene import Scene
from .scene_file import open_scene
from .view import make_view

# Without a tree, the cost is rays times triangles: with more triangles than this, a picture would take hours.
BRUTE_LIMIT = 100_000

# Most ray-triangle tests of a validation: about a second.
_VALIDATION_TESTS = 50_000_000


@dataclass(frozen=True)
class RenderOptions(TreeOptions):
    """The options of a rendering that do not change the picture.

    Attributes
    ----------
    builder, workers, build, cache
        See `TreeOptions`. The builder may also be ``"brute"``: no tree.
    device : DeviceInfo, str, int or None
        See `choose_device`.
    layout : str
        Layout of the tree on the device, or ``"auto"``: the one that suits the device, but ``"bvh2"`` for the builder
        ``"frontier"``, because a wide layout would split its large leaves.
    validate : bool
        Check the tree, and compare a sample of the pixels with the slow reference.

    Examples
    --------
    >>> import clbvh
    >>> options = clbvh.RenderOptions(layout="bvh4", validate=True)
    >>> clbvh.render(clbvh.make_shape("knot", triangles=20_000), options).validated_pixels > 0
    True
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
        """The layout to ask the device for, with ``"auto"`` resolved where the builder decides."""
        return "bvh2" if self.layout == "auto" and self.builder == "frontier" else self.layout


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
        A scene, or anything that `open_scene` takes.
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

    Examples
    --------
    >>> import clbvh
    >>> picture = clbvh.render("demo")  # a shipped scene; or a scene file, a mesh file
    >>> picture.rgb.shape
    (720, 1280, 3)
    >>> scene = clbvh.open_scene("demo").with_changes(width=320, height=180, shading="normal")
    >>> clbvh.render(scene).rgb.shape
    (180, 320, 3)
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
        tree_upload_ms = session.times.sums_ms()["upload"]
        renderer = FrameRenderer(session, tree)
        watch.lap("compile")

        on_phase("render")
        colours, found = renderer.render(make_view(scene, camera, mesh))
        total_ms = watch.total_ms
        timings = _list_timings(watch.laps_ms, made, tree_upload_ms, session.times.sums_ms(), total_ms)
    picture = Picture(
        rgb=np.ascontiguousarray(colours[..., :3]),
        found=found,
        camera=camera,
        mesh=mesh,
        bvh=bvh,
        device=session.info,
        layout=tree.layout,
        workers=1 if made is None else made.workers,
        timings=timings,
        tree_from_cache=made is not None and made.from_cache,
        notes=() if made is None else made.notes,
    )
    if options.validate:
        on_phase("validate")
        picture = replace(picture, validated_pixels=_validate(mesh, bvh, camera, picture.hits, options))
    return picture


def _list_timings(
    laps_ms: Mapping[str, float],
    made: MadeTree | None,
    tree_upload_ms: float,
    device_ms: Mapping[str, float],
    total_ms: float,
) -> dict[str, float]:
    """Return the timings of a `Picture`; `device_ms` are the device's own times, the tree's upload included."""
    phases_ms = {
        "load": laps_ms["load"],
        **(dict.fromkeys(("pool_start", "cache", "build"), 0.0) if made is None else made.timings_ms),
        "compile": laps_ms["open"] + laps_ms["compile"],
        # The tree is uploaded as it is arranged; the upload has a row of its own.
        "layout": max(laps_ms["layout"] - tree_upload_ms, 0.0),
        **{phase: device_ms[phase] for phase in ("upload", "kernel", "download")},
    }
    return add_total(phases_ms, total_ms, overlapping=("pool_start",))


def _validate(mesh: Mesh, bvh: Bvh | None, camera: Camera, hits: Hits, options: RenderOptions) -> int:
    """Check the tree and a sample of the pixels; return the number of pixels."""
    if bvh is not None:
        validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_limit(options.builder, options.build))
    height, width = hits.prim_id.shape
    pixel_count = min(width * height, max(1, _VALIDATION_TESTS // mesh.face_count))
    # Spread evenly over the picture, the same ones each time; all of them if there are few.
    pixels = np.linspace(0, width * height - 1, pixel_count).astype(np.int64)
    origins, directions = camera.rays(width, height)
    differences = find_differences(
        mesh, origins.reshape(-1, 3)[pixels], directions.reshape(-1, 3)[pixels], hits.take(pixels)
    )
    if differences:
        first = differences[0]
        row, column = divmod(int(pixels[first.ray]), width)
        raise ValidationError(
            f"{len(differences)} of {pixel_count} pixels differ from the reference; the first one is at column "
            f"{column}, row {row}: {first}"
        )
    return pixel_count
