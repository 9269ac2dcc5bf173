"""Measures which layout, work-group and tile are the fastest on a device: the answer behind `clbvh tune`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..builders.build import build
from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..device.open import open_device
from ..device.session import DeviceSession, ReusableBuffer
from ..device.settings import Settings, default_settings
from ..geometry.shapes.make_shape import make_shape
from ..scene.scene import Scene
from ..structs import HIT, LAYOUT_WIDTHS, PACKED_RAY
from ..trace.rays.batch import read_rays
from ..trace.rays.pack import pack_rays
from ..trace.world.starts import AT_THE_ROOT, TILE_KERNEL, find_entry_points
from ..trace.world.tree_box import TreeBox
from ..trace.world.world import World, open_world
from .cameras.camera import Camera
from .cameras.framing import frame_mesh
from .kernel_view import make_kernel_view
from .painters import FrameRenderer, OneRayPainter
from .view import View

TRIANGLES = 100_000
WIDTH, HEIGHT = 640, 360
_RUNS = 5

_WORK_GROUP_SIZES = (16, 32, 64, 128, 256)
_TILES = ((4, 4), (8, 4), (8, 8), (16, 8), (16, 16), (32, 4), (64, 1))

# A choice replaces the rule's only if it is faster by this share: less may be chance.
_LEAST_GAIN = 0.02


@dataclass(frozen=True)
class Trial:
    """One thing that was measured.

    Attributes
    ----------
    what : str
        ``"layout"``, ``"work-group size"`` or ``"tile"``.
    choice : str
    ms : float
        Of the kernels, the fastest of several runs: one over neighbouring and one over shuffled rays, or a picture.
    is_best : bool
        Whether it was chosen.
    """

    what: str
    choice: str
    ms: float
    is_best: bool = False


def tune(
    device: DeviceInfo | str | int | None = None, *, triangles: int = TRIANGLES, size: tuple[int, int] = (WIDTH, HEIGHT)
) -> tuple[DeviceInfo, Settings, list[Trial]]:
    """Measure a device; nothing is kept.

    Parameters
    ----------
    device : DeviceInfo, str, int or None
        See `Tracer`.
    triangles : int
        Of the procedural mesh.
    size : (int, int)
        Width and height of the picture.

    Returns
    -------
    info : DeviceInfo
    settings : Settings
        The fastest ones.
    trials : list of Trial
        Everything that was measured.

    Raises
    ------
    DeviceError
        There is no such device, or it fails.
    """
    mesh = make_shape("knot", triangles=triangles)
    bvh = build(mesh)
    camera = frame_mesh(mesh, aspect=size[0] / size[1])
    with open_device(device) as session:
        chosen = default_settings(session.info)
        trials: list[Trial] = []
        state = Scene(mesh).snapshot()
        worlds = {layout: open_world(session, state, [bvh], layout) for layout in LAYOUT_WIDTHS}
        neighbours, *_ = orders = [session.upload(rays) for rays in _make_rays(camera, bvh, size)]
        ray_count = size[0] * size[1]
        results = session.allocate(ray_count * HIT.itemsize)
        driver = session.info.cl_device  # none of the host, where a work-group is a loop
        largest = driver.max_work_group_size if driver else max(_WORK_GROUP_SIZES)

        def casts(world: World, work_group_size: int) -> Callable[[], object]:
            kernel = session.kernel("closest_hit", world.defines)
            starts_kernel = session.kernel(TILE_KERNEL, world.defines) if world.has_entry_points else None
            work, group = (ray_count, 1), (work_group_size, 1)
            buffer = ReusableBuffer(session)

            def take(_: str, size: int) -> Any:
                return buffer.take(size)

            def run() -> None:
                for rays in orders:
                    described = {
                        "rays": rays, "lows": None, "low_step": np.int32(0), "ray_count": np.int32(ray_count),
                        "row_length": np.int32(ray_count),
                    }  # fmt: skip
                    starts = AT_THE_ROOT
                    if rays is neighbours and starts_kernel is not None:
                        starts = find_entry_points(session, world, starts_kernel, take, work, group, **described)
                    session.run(kernel, work, group, **world.arguments, **described, **starts, hits=results, order=None)

            return run

        def find_best(what: str, usual: Any, choices: Iterable[Any], make_task: Callable[[Any], Any]) -> Any:
            return _choose(trials, what, _measure(session, {each: make_task(each) for each in choices}), usual)

        usual_size = chosen.work_group_size
        layout = find_best("layout", chosen.layout, worlds, lambda layout: casts(worlds[layout], usual_size))
        world = worlds[layout]
        group_sizes = (each for each in _WORK_GROUP_SIZES if each <= largest)
        work_group_size = find_best("work-group size", usual_size, group_sizes, partial(casts, world))

        wanted = View(width=size[0], height=size[1], shading="lambert+shadow", up=camera.up)
        view = make_kernel_view(wanted, camera, mesh)

        def draws(tile: tuple[int, int]) -> Callable[[], object]:
            return partial(FrameRenderer(session, world).render, view, OneRayPainter(session, world, tile))

        tile = find_best("tile", chosen.tile, (each for each in _TILES if each[0] * each[1] <= largest), draws)
        # Rays with the best work-groups, and the picture with the best tiles.
        ms = sum(trial.ms for trial in trials if trial.is_best and trial.what != "layout")
        chosen = Settings(layout, work_group_size, tile, is_measured=True, measured_ms=ms)
        return session.info, chosen, trials


def _make_rays(camera: Camera, bvh: Bvh, size: tuple[int, int]) -> list[NDArray[np.void]]:
    """Return the rays of a picture, in its order and shuffled."""
    batch, _ = read_rays(*camera.rays(*size), 0.0, np.inf)
    rays = np.empty(batch.ray_count, PACKED_RAY)
    pack_rays(batch, batch.part(0, batch.ray_count), TreeBox.around(bvh), rays)
    return [rays, np.random.default_rng(0).permutation(rays)]


def _measure(session: DeviceSession, tasks: dict[Any, Callable[[], object]]) -> dict[Any, float]:
    """Return the least milliseconds that the kernels of each task took; the tasks take turns."""
    best = dict.fromkeys(tasks, np.inf)
    for _ in range(_RUNS):
        for name, task in tasks.items():
            before = session.times.sums_ms().get("kernel", 0.0)
            task()
            best[name] = min(best[name], session.times.sums_ms()["kernel"] - before)
    return best


def _choose(trials: list[Trial], what: str, ms: dict[Any, float], usual: Any) -> Any:
    """Return the fastest choice, or the usual one where that is as fast; note all of them."""
    best = min(ms, key=lambda choice: ms[choice])
    if usual in ms and ms[best] > (1 - _LEAST_GAIN) * ms[usual]:
        best = usual
    for choice, its_ms in ms.items():
        text = " x ".join(map(str, choice)) if isinstance(choice, tuple) else str(choice)
        trials.append(Trial(what, text, float(its_ms), choice == best))
    return best
