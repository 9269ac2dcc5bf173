"""The painters of one renderer: each shading is compiled, and surfaces get their looks, when first asked for."""

from __future__ import annotations

import threading
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..choices import REPORT_SHADINGS
from ..device.info import DeviceInfo
from ..device.program import build_kernel
from ..device.session import DeviceSession
from ..support.host_threads import side_by_side
from ..trace.traced_tree import TracedTree
from .band_painters import DEVELOP, OneRayPainter, Progress, SamplePainter, SampleShading
from .film.environment_map import EnvironmentMap, EnvironmentTables, make_environment_tables
from .film.light_tables import LightTables, find_lights, make_light_tables
from .film.look_tables import LookTables, has_cutouts, has_normal_maps, make_look_tables
from .frame import Painter
from .view import View
from .world import World


def open_session(device: DeviceInfo | str | int | None, shading: str) -> DeviceSession:
    """Open a device, and load the kernel that depends on no tree, where the painter of a shading has one."""
    session = DeviceSession(device)
    if shading not in REPORT_SHADINGS:
        build_kernel(session, DEVELOP)
    return session


class Painters:
    """Makes the painter of each picture; from any number of threads.

    Parameters
    ----------
    session : DeviceSession
        Owns the tables on the device.
    tree : DeviceTree or DeviceScene
    world : World
    """

    def __init__(self, session: DeviceSession, tree: TracedTree, world: World) -> None:
        self._session, self._tree, self._world = session, tree, world
        self._lock = threading.Lock()
        self._one_ray: dict[tuple[int, ...], OneRayPainter] = {}  # by `_parts_of`
        self._lights: LightTables | None = None
        self._looks: dict[float, tuple[LookTables, dict[str, Any]]] = {}  # by the crease angle
        self._shadings: dict[tuple[Any, ...], tuple[SampleShading, dict[str, Any]]] = {}
        self._environments: dict[EnvironmentMap, tuple[EnvironmentTables, dict[str, Any]]] = {}

    def painter(self, view: View, described: NDArray[np.void], progress: Progress) -> Painter:
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
        with self._lock:
            if view.shading in REPORT_SHADINGS:
                parts = _parts_of(view)
                key = tuple(parts.values())
                if key not in self._one_ray:
                    colours = self._world.looks.colours
                    self._one_ray[key] = OneRayPainter(self._session, self._tree, colours=colours, parts=parts)
                progress.taken = 1
                return self._one_ray[key]
            if view.shading == "path":
                self._find_lights().describe(described)
            has_ground = view.shading == "path" and bool(described["ground_radius"][0] > 0)
            shading, buffers = self._find_shading(view, has_ground)
            if view.shading == "path":
                buffers = buffers | self._find_environment(view, described)
            return SamplePainter(shading, progress, buffers)

    def _find_shading(self, view: View, has_ground: bool) -> tuple[SampleShading, dict[str, Any]]:
        """Return a shading with its kernels compiled, and the tables of the surfaces on the device."""
        parts = _parts_of(view) | {"HAS_GROUND": int(has_ground)}
        key = view.shading, float(view.smooth), *parts.values()
        if key not in self._shadings:
            shapes = self._world.looks.shapes
            parts |= {"HAS_CUTOUTS": int(has_cutouts(shapes)), "HAS_NORMAL_MAPS": int(has_normal_maps(shapes))}
            compile_kernels = partial(SampleShading, self._session, self._tree, view.shading, parts)
            # Side by side: a driver compiles, or loads what it has compiled, without Python's lock.
            shading, buffers = side_by_side(compile_kernels, partial(self._find_tables, view))
            self._shadings[key] = shading, buffers
        return self._shadings[key]

    def _find_tables(self, view: View) -> dict[str, Any]:
        """Return the tables that the kernels of a shading read, on the device."""
        _, buffers = self._find_looks(view)
        if view.shading == "path":
            lights = self._find_lights()
            buffers = buffers | {name: self._session.upload(array) for name, array in lights.arrays.items()}
        return buffers

    def _find_lights(self) -> LightTables:
        if self._lights is None:
            looks = self._world.looks
            self._lights = make_light_tables(looks.shapes, looks.shape_ids, self._world.to_local())
        return self._lights

    def _find_environment(self, view: View, described: NDArray[np.void]) -> dict[str, Any]:
        """Return the environment on the device, where it stays for other pictures; describe how it is seen."""
        if view.environment is None:
            return {}
        if view.environment not in self._environments:
            tables = make_environment_tables(view.environment.pixels)
            buffers = {name: self._session.upload(array) for name, array in tables.arrays.items()}
            self._environments[view.environment] = tables, buffers
        tables, buffers = self._environments[view.environment]
        tables.describe(described, view)
        return buffers

    def _find_looks(self, view: View) -> tuple[LookTables, dict[str, Any]]:
        angle = float(view.smooth)
        if angle not in self._looks:
            looks = self._world.looks
            is_light = find_lights(looks.shapes, looks.shape_ids, self._world.to_local())
            tables = make_look_tables(looks, is_light, angle)
            self._looks[angle] = tables, tables.upload(self._session)
        return self._looks[angle]


def _parts_of(view: View) -> dict[str, int]:
    """Return the macros of the parts of kernels that all shadings have."""
    return {"HAS_CUT": int(view.cut is not None), "HAS_WIREFRAME": int(view.wireframe is not None)}
