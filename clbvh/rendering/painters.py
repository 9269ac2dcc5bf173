"""The painters of one renderer: each shading is compiled, and surfaces get their looks, when first asked for."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..device.session import DeviceSession
from ..structs import REPORT_SHADINGS
from ..trace.traced_tree import TracedTree
from .film.environment_map import EnvironmentMap
from .film.environment_tables import EnvironmentTables, make_environment_tables
from .film.light_tables import LightTables, find_lights, make_light_tables
from .film.look_tables import LookTables, make_look_tables
from .film.sample_painter import Progress, SamplePainter, SampleShading
from .frame import Painter
from .mesh_subject import MeshSubject
from .one_ray import OneRayPainter
from .scene import Scene
from .scene_subject import SceneSubject


class Painters:
    """Makes the painter of each picture; from any number of threads.

    Parameters
    ----------
    session : DeviceSession
        Owns the tables on the device.
    tree : DeviceTree or DeviceScene
    subject : MeshSubject or SceneSubject
    """

    def __init__(self, session: DeviceSession, tree: TracedTree, subject: MeshSubject | SceneSubject) -> None:
        self._session, self._tree, self._subject = session, tree, subject
        self._lock = threading.Lock()
        self._one_ray: dict[bool, OneRayPainter] = {}  # by whether there is a cut
        self._lights: LightTables | None = None
        self._looks: dict[float, tuple[LookTables, dict[str, Any]]] = {}  # by the crease angle
        self._shadings: dict[tuple[str, float, bool], SampleShading] = {}
        self._environments: dict[EnvironmentMap, tuple[EnvironmentTables, dict[str, Any]]] = {}

    def painter(self, scene: Scene, view: NDArray[np.void], progress: Progress) -> Painter:
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
            if scene.shading in REPORT_SHADINGS:
                has_cut = scene.cut is not None
                if has_cut not in self._one_ray:
                    colours = self._subject.looks().colours
                    self._one_ray[has_cut] = OneRayPainter(self._session, self._tree, colours=colours, has_cut=has_cut)
                progress.taken = 1
                return self._one_ray[has_cut]
            if scene.shading == "path":
                self._find_lights(scene).describe(view)
                return SamplePainter(self._find_shading(scene), progress, self._find_environment(scene, view))
            return SamplePainter(self._find_shading(scene), progress)

    def _find_shading(self, scene: Scene) -> SampleShading:
        key = scene.shading, float(scene.smooth), scene.cut is not None
        if key not in self._shadings:
            tables, buffers = self._find_looks(scene)
            if scene.shading == "path":
                lights = self._find_lights(scene)
                buffers = buffers | {name: self._session.upload(array) for name, array in lights.arrays.items()}
            self._shadings[key] = SampleShading(
                self._session,
                self._tree,
                scene.shading,
                buffers,
                has_cutouts=tables.has_cutouts,
                has_cut=scene.cut is not None,
            )
        return self._shadings[key]

    def _find_lights(self, scene: Scene) -> LightTables:
        if self._lights is None:
            looks = self._subject.looks()
            self._lights = make_light_tables(looks.shapes, looks.shape_ids, self._subject.to_local())
        return self._lights

    def _find_environment(self, scene: Scene, view: NDArray[np.void]) -> dict[str, Any]:
        """Return the environment on the device, where it stays for other pictures; say in the view how it is seen."""
        if scene.environment is None:
            return {}
        if scene.environment not in self._environments:
            tables = make_environment_tables(scene.environment.pixels)
            buffers = {name: self._session.upload(array) for name, array in tables.arrays.items()}
            self._environments[scene.environment] = tables, buffers
        tables, buffers = self._environments[scene.environment]
        tables.describe(view, scene)
        return buffers

    def _find_looks(self, scene: Scene) -> tuple[LookTables, dict[str, Any]]:
        angle = float(scene.smooth)
        if angle not in self._looks:
            looks = self._subject.looks()
            is_light = find_lights(looks.shapes, looks.shape_ids, self._subject.to_local())
            tables = make_look_tables(looks, is_light, angle)
            self._looks[angle] = tables, tables.upload(self._session)
        return self._looks[angle]
