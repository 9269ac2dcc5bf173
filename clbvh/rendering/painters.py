"""The painters of pictures: each fills a band, by one ray through each pixel's centre or by samples on a film.

Each shading is compiled, and surfaces get their looks, when a picture first asks for them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..choices import REPORT_SHADINGS, SHADINGS
from ..device.info import DeviceInfo
from ..device.open import open_device
from ..device.session import DeviceSession
from ..support.forks import make_lock
from ..support.host_threads import side_by_side
from ..trace.world.starts import AT_THE_ROOT, VIEW_KERNEL, find_entry_points
from ..trace.world.world import World
from ..views.view import View
from .drawn_scene import DrawnScene
from .frame import BORDER, DEVELOP, FILM_BYTES, Band
from .look_tables import LightTables, find_lights, has_cutouts, has_normal_maps, make_light_tables, make_look_tables
from .noisy_tiles import ALL_ALIKE, NoisyTiles
from .progress import Progress

# Macros of kernels for views without a cut and without lines.
NO_PARTS = {"HAS_CUT": 0, "HAS_WIREFRAME": 0}


class _ViewEntryPoints:
    """Finds the entry points of a camera's rays, which are within a margin of pixels around each pixel's centre."""

    def __init__(self, session: DeviceSession, world: World, tile: tuple[int, int], margin: float) -> None:
        self._world, self._tile, self._margin = world, tile, np.float32(margin)
        self._kernel = session.kernel(VIEW_KERNEL, world.defines) if world.has_entry_points else None

    def find(self, band: Band) -> dict[str, Any]:
        """Return the arguments of kernels that say where the rays of a band begin, by their names."""
        if self._kernel is None:
            return AT_THE_ROOT
        return find_entry_points(
            band.memory.session, self._world, self._kernel, band.take, band.size, self._tile,
            margin=self._margin, **band.rows,
        )  # fmt: skip


class OneRayPainter:
    """Casts one ray for each pixel, and colours what it hits; see cl/kernels/render.cl.

    Parameters
    ----------
    session : DeviceSession
    world : World
    colours : (n, 3) float, optional
        Linear colours of the instances; NaN, and by default: that of the view.
    parts : mapping of str to int
        Macros of the parts of the kernel that views need, as `NO_PARTS`.
    closed : buffer or None
        Of `DrawnScene.closed`, where there is a cut.

    Attributes
    ----------
    pixel_bytes : int
        Bytes of the largest buffer for each pixel, beside those of the band.

    Raises
    ------
    KernelBuildError
        The device's compiler refuses the kernel.
    """

    pixel_bytes = 0

    def __init__(
        self,
        session: DeviceSession,
        world: World,
        colours: NDArray[np.floating] | None = None,
        parts: Mapping[str, int] = NO_PARTS,
        closed: Any = None,
    ) -> None:
        own = np.full((1, 3), np.nan) if colours is None else colours
        has_own = ~np.isnan(own).any(axis=1, keepdims=True)
        rows = np.concatenate((np.where(has_own, own, 0.0), has_own), axis=1).astype(np.float32)
        self._arguments = world.arguments | {"instance_colours": session.upload(rows), "closed": closed}
        self._tile = session.settings.tile
        self._kernel = session.kernel("render", {**world.defines, **parts})
        self._entry_points = _ViewEntryPoints(session, world, self._tile, 0.0)

    def paint(self, band: Band) -> float:
        """Fill the colours and the hits of a band; return the seconds of the launch."""
        begin = time.perf_counter()
        starts = self._entry_points.find(band)
        outputs = {"colours": band.colours, "hits": band.hits}
        band.run(self._kernel, band.size, self._tile, **self._arguments, **starts, **band.rows, **outputs)
        band.memory.session.finish()
        band.report(1.0)
        return time.perf_counter() - begin


# A launch takes a multiple of it, but for the last one: the samples of a pair share work, see cl/film/studio.cl.
_LEAST_SAMPLES = 2

# Samples of cells that wait to be added: of large pictures, _LEAST_SAMPLES of each.
_WAITING_BYTES = 2**25

# Pixels around the centre of a pixel in which its samples are, see cl/film/pixel.cl.
_FILTER_RADIUS = 1.0

# Arguments of `render_samples` that only paths have.
_NO_LIGHTS: dict[str, Any] = dict.fromkeys(
    ("lights", "light_choices", "environment", "environment_rows", "environment_columns", "settled")
)


class _SampleShading:
    """One of the shadings with samples, compiled for a tree or a scene.

    Parameters
    ----------
    session : DeviceSession
    world : World
    shading : str
        ``"studio"``, ``"ao"``, ``"path"`` or ``"albedo"``.
    parts : mapping of str to int
        Macros of the parts of the kernel that views need: those of `NO_PARTS`, and HAS_CUTOUTS, HAS_NORMAL_MAPS and
        HAS_GROUND.

    Attributes
    ----------
    add_samples : Kernel or None
        Adds samples of cells to the film; None where they are samples of pixels, and added as they are taken.
    """

    def __init__(self, session: DeviceSession, world: World, shading: str, parts: Mapping[str, int]) -> None:
        self.tile = session.settings.tile
        self.has_cutouts = parts["HAS_CUTOUTS"]
        self.arguments = world.arguments | _NO_LIGHTS
        defines = {**world.defines, "SHADING": SHADINGS[shading], **parts}
        self.kernel = session.kernel("render_samples", defines)
        self.develop = session.kernel(DEVELOP)
        self.add_samples = session.kernel("add_samples") if shading == "path" else None
        self.entry_points = _ViewEntryPoints(session, world, self.tile, _FILTER_RADIUS)


@dataclass
class SamplePainter:
    """Takes the samples of one picture.

    Attributes
    ----------
    shading : _SampleShading
    progress : Progress
    arguments : mapping of str to argument
        The tables of cl/looks/, and those of the light and the environment of ``"path"``.
    begin : float
        When the time of `progress` begins.
    """

    shading: _SampleShading
    progress: Progress
    arguments: Mapping[str, Any]
    begin: float = field(default_factory=lambda: time.perf_counter())

    @property
    def pixel_bytes(self) -> int:
        """Bytes of the largest buffer for each pixel, beside those of the band."""
        return FILM_BYTES * (_LEAST_SAMPLES if self.shading.add_samples else 1)

    def paint(self, band: Band) -> float:
        """Fill the colours and the hits of a band; return the seconds of the first launch."""
        shading, progress = self.shading, self.progress
        film = band.take("film", band.width * band.row_count * FILM_BYTES)
        sample = self._sample_cells if shading.add_samples else self._sample_pixels
        taken, launch_s, tiles = sample(band, film)
        band.run(
            shading.develop, band.size, shading.tile, film=film, row_count=np.int32(band.row_count),
            sample_count=np.int32(taken), counts=tiles.arguments["counts"] if tiles else None, view=band.view,
            colours=band.colours,
        )  # fmt: skip
        progress.of_bands[band.first_row] = tiles.mean_samples(taken) if tiles else taken
        if (kept := progress.film) is not None:
            rows_of_film = kept[band.first_row : band.first_row + band.row_count]
            band.memory.session.download(film, rows_of_film)
            rows_of_film /= tiles.samples_of_pixels() if tiles else np.float32(taken)
        return launch_s

    def _sample_pixels(self, band: Band, film: Any) -> tuple[int, float, None]:
        """Add samples of pixels to the film; return as `_take_samples`, and no tiles."""
        shading = self.shading
        fixed = {**shading.arguments, **self.arguments, **band.rows, **shading.entry_points.find(band)}

        def take(**chosen: Any) -> None:
            band.run(shading.kernel, band.size, shading.tile, **fixed, film=film, hits=band.hits, **chosen)

        return *self._take_samples(band, take, self.progress.samples), None

    def _sample_cells(self, band: Band, film: Any) -> tuple[int, float, NoisyTiles | None]:
        """Add samples of cells to the film; return as `_take_samples`, and the tiles, if noise decides."""
        shading, progress = self.shading, self.progress
        cells = band.width + BORDER, band.row_count + BORDER
        sample_bytes = cells[0] * cells[1] * FILM_BYTES
        most = min(progress.samples, max(_LEAST_SAMPLES, _WAITING_BYTES // sample_bytes))
        samples = band.take("samples", most * sample_bytes)
        tiles = NoisyTiles(band, cells, shading.tile, progress.noise) if progress.noise else None
        of_tiles = tiles.arguments if tiles else ALL_ALIKE
        # Cells are not the tiles of pixels for which entry points are found: their rays begin at the root.
        fixed = {**shading.arguments, **self.arguments, **band.rows, **AT_THE_ROOT, "settled": of_tiles["settled"]}
        of_film = {"width": np.int32(band.width), "row_count": np.int32(band.row_count), "film": film}
        is_apart = np.int32(progress.is_apart)

        def take(**chosen: Any) -> None:
            band.run(shading.kernel, cells, shading.tile, **fixed, film=samples, hits=band.hits, **chosen)
            band.run(
                shading.add_samples, cells, shading.tile, samples=samples, is_apart=is_apart, **of_film, **of_tiles,
                **chosen,
            )  # fmt: skip

        return *self._take_samples(band, take, most, tiles), tiles

    def _take_samples(
        self, band: Band, take: Callable[..., None], most: int, tiles: NoisyTiles | None = None
    ) -> tuple[int, float]:
        """Take samples, `most` of them in a launch; return their number and the seconds of the first launch."""
        progress, first_s = self.progress, 0.0
        first, count = 0, min(_LEAST_SAMPLES, progress.samples)
        end_s = self.begin + progress.time_limit_s * (band.first_row + band.row_count) / band.height
        while True:
            begin = time.perf_counter()
            take(first_sample=np.int32(first), sample_count=np.int32(count))
            band.memory.session.finish()
            now = time.perf_counter()
            first_s = first_s or now - begin
            first += count
            done = first / progress.samples
            if tiles is not None:
                if first == tiles.end:
                    tiles.end_pass()
                done = max(done, tiles.settled_share)
            band.report(done)
            if done >= 1.0 or progress.is_stopped() or now > end_s:
                return first, first_s
            fitting = int(progress.launch_s * count / max(now - begin, 1e-9)) // _LEAST_SAMPLES * _LEAST_SAMPLES
            end = progress.samples if tiles is None else min(tiles.end, progress.samples)
            count = min(end - first, max(_LEAST_SAMPLES, min(fitting, most)))


def open_session(device: DeviceInfo | str | int | None, shading: str) -> DeviceSession:
    """Open a device, and load the kernel that depends on no tree, where the painter of a shading has one."""
    session = open_device(device)
    if shading not in REPORT_SHADINGS:
        session.kernel(DEVELOP)
    return session


class Painters:
    """Makes the painter of each picture; from any number of threads.

    Parameters
    ----------
    session : DeviceSession
        Owns the tables on the device.
    world : World
    scene : DrawnScene
    """

    def __init__(self, session: DeviceSession, world: World, scene: DrawnScene) -> None:
        self._session, self._world, self._scene = session, world, scene
        self._lock = make_lock()
        self._known: dict[Any, Any] = {}
        self._tables: dict[Any, Any] = {}  # that no transform changes
        self._environments: dict[Any, Any] = {}

    def at(self, world: World, scene: DrawnScene) -> Painters:
        """Return the painters of a scene that has moved; the tables that do not depend on that are shared."""
        moved = copy(self)
        moved._world, moved._scene, moved._known = world, scene, {}
        if scene.state.shapes is not self._scene.state.shapes:
            moved._tables = {}
        return moved

    def painter(self, view: View, kernel_view: NDArray[np.void], progress: Progress) -> OneRayPainter | SamplePainter:
        """Return the painter of a picture, and fill what the view says of the light.

        Raises
        ------
        KernelBuildError
            The device's compiler refuses a kernel.
        DeviceError
            The device has too little memory for the tables.
        SceneError
            The file of the environment cannot be read.
        """
        parts = {"HAS_CUT": int(view.cut is not None), "HAS_WIREFRAME": int(view.wireframe is not None)}
        with self._lock:
            if view.shading in REPORT_SHADINGS:
                colours, closed = self._scene.looks.colours, self._find_closed(view)
                make = partial(OneRayPainter, self._session, self._world, colours, parts, closed)
                return _keep(self._known, ("one ray", closed is None, *parts.values()), make)
            is_path = view.shading == "path"
            if is_path:
                lights = self._find_lights()
                kernel_view["light_count"], kernel_view["light_power"] = lights.count, lights.power
            parts["HAS_GROUND"] = int(is_path and bool(kernel_view["ground_radius"][0] > 0))
            key = view.shading, view.smooth, *parts.values()
            shading, buffers = _keep(self._known, key, lambda: self._make_shading(view, parts))
            kernel_view["has_cutouts"] = shading.has_cutouts
            if is_path and view.environment is not None:
                buffers = buffers | self._find_environment(view, kernel_view)
            return SamplePainter(shading, progress, {**buffers, "closed": self._find_closed(view)})

    def _find_closed(self, view: View) -> Any:
        """Return which instances a cut shows a section of, on the device; None without one."""
        if view.cut is None or not view.section.fill:
            return None
        return _keep(self._known, "closed", lambda: self._session.upload(self._scene.closed))

    def _upload(self, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        return {name: self._session.upload(array) for name, array in arrays.items()}

    def _make_shading(self, view: View, parts: dict[str, int]) -> tuple[_SampleShading, dict[str, Any]]:
        """Return a shading with its kernels compiled, and the tables of the surfaces on the device."""
        shapes = self._scene.looks.shapes
        parts |= {"HAS_CUTOUTS": int(has_cutouts(shapes)), "HAS_NORMAL_MAPS": int(has_normal_maps(shapes))}
        compile_kernels = partial(_SampleShading, self._session, self._world, view.shading, parts)
        # Side by side: a driver compiles, or loads what it has compiled, without Python's lock.
        shading, buffers = side_by_side(compile_kernels, partial(self._find_tables, view))
        return shading, buffers

    def _find_tables(self, view: View) -> dict[str, Any]:
        """Return the tables that the kernels of a shading read, on the device."""
        looks = self._scene.looks
        is_light = find_lights(looks.shapes, looks.shape_ids, self._scene.to_local())
        key = "looks", view.smooth, is_light.tobytes()
        buffers = _keep(self._tables, key, lambda: self._upload(make_look_tables(looks, is_light, view.smooth)))
        return buffers | self._upload(self._find_lights().arrays) if view.shading == "path" else buffers

    def _find_lights(self) -> LightTables:
        (shapes, shape_ids, _), scene = self._scene.looks, self._scene
        shown = np.flatnonzero(scene.state.masks)
        make = partial(make_light_tables, shapes, shape_ids[shown], scene.to_local()[shown])
        return _keep(self._known, "lights", make)

    def _find_environment(self, view: View, kernel_view: NDArray[np.void]) -> dict[str, Any]:
        """Return the environment on the device, where it stays for other pictures; describe how it is seen."""
        from .environment_tables import make_environment_tables  # most pictures have none

        assert view.environment is not None

        def make() -> Any:
            tables = make_environment_tables(view.environment.pixels)  # type: ignore[union-attr]
            return tables, self._upload(tables.arrays)

        tables, buffers = _keep(self._environments, view.environment, make)
        tables.describe(kernel_view, view)
        return buffers


def _keep(known: dict[Any, Any], key: Any, make: Callable[[], Any]) -> Any:
    if key not in known:
        known[key] = make()
    return known[key]
