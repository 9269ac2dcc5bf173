"""The part of a renderer that knows where to look from: cameras that show a whole scene, its ground and its strays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from numbers import Integral

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh
from ..support.context_manager import ContextManager
from .bulk import Bulk, find_bulk
from .camera import Camera
from .film.ground import Ground, find_ground, shows_ground
from .framing import frame_mesh, frame_turn, measure_side
from .mesh_subject import MeshSubject
from .projection import Orthographic, Panorama, Projection
from .scene import Scene
from .scene_extent import SceneExtent
from .scene_subject import SceneSubject
from .standard_views import STANDARD_VIEWS
from .upright import AUTO, find_upright, known_up
from .vectors import Vector
from .view import sky_direction


class RendererViews(ContextManager):
    """A scene and its extent, as cameras see it. `Renderer` opens and closes it."""

    scene: Scene
    _subject: MeshSubject | SceneSubject

    def _stand_upright(self) -> None:
        """Replace the scene's `up` by a direction, and find its camera; the subject must be loaded."""
        self._bulk: Bulk | None = None
        up, self._up_note = find_upright(self.scene, self._find_extent(self.scene))
        self.scene = self.scene.with_changes(up=up)
        self._framed = self._frame(self.scene)
        self._ground: tuple[Mesh | SceneExtent, NDArray[np.float64], Ground] | None = None

    @property
    def camera(self) -> Camera:
        """The scene's camera, in a picture of the scene's size."""
        return self._find_camera(self.scene)

    def turntable(
        self, count: int, *, width: int | None = None, height: int | None = None, up: Vector | None = None
    ) -> list[Camera]:
        """Return the cameras of a full turn, which all see the whole mesh from the same distance.

        Parameters
        ----------
        count : int
            Cameras, at equal angles; the last one is one step before the first.
        width, height : int, pixels
            Size of the pictures; by default the scene's.
        up : (3,) float
            The axis of the turn, through the middle of the mesh's box; by default the scene's `up`.

        Raises
        ------
        SceneError
            A value is out of range, or the scene's projection is a panorama, which has no turn.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320)) as renderer:
        ...     pictures = [renderer.render(camera=camera) for camera in renderer.turntable(4)]
        >>> len(pictures)
        4
        """
        if isinstance(count, bool) or not isinstance(count, Integral) or count < 1:
            raise SceneError(f"a turn has at least one camera, not {count!r}")
        scene = self.scene.with_changes(width=width, height=height, up=up)
        first = frame_turn(
            self._find_extent(scene),
            aspect=scene.width / scene.height,
            up=known_up(scene),
            fov=scene.fov,
            projection=scene.projection,
        )
        if scene.aperture:
            first = replace(first, aperture=scene.aperture, focus_distance=scene.focus_distance)
        return [first.orbit(360.0 * number / count) for number in range(count)]

    def orthographic_views(
        self,
        views: Sequence[str] = STANDARD_VIEWS,
        *,
        width: int | None = None,
        height: int | None = None,
        up: Vector | None = None,
    ) -> dict[str, Camera]:
        """Return orthographic cameras of sides, which all see the whole mesh at one scale.

        Parameters
        ----------
        views : sequence of str
            See `Scene.view`.
        width, height : int, pixels
            Size of the pictures; by default the scene's.
        up : (3,) float
            By default the scene's `up`.

        Raises
        ------
        SceneError
            A value is out of range.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320)) as renderer:
        ...     cameras = renderer.orthographic_views(["front", "top"])
        >>> cameras["front"].up
        (0.0, 1.0, 0.0)
        """
        scene = self.scene.with_changes(width=width, height=height, up=up)
        aspect, extent = scene.width / scene.height, self._find_extent(scene)
        cameras = {
            view: frame_mesh(extent, aspect=aspect, up=known_up(scene), projection=Orthographic(), side=view)
            for view in views
        }
        tallest = max((camera.projection for camera in cameras.values()), key=_height_of, default=None)
        return {view: replace(camera, projection=tallest) for view, camera in cameras.items()}

    def measure_views(
        self, views: Sequence[str] = STANDARD_VIEWS, *, up: Vector | None = None
    ) -> dict[str, tuple[float, float]]:
        """Return the width and the height of the whole mesh, seen without perspective from each side.

        Parameters
        ----------
        views : sequence of str
            See `Scene.view`.
        up : (3,) float
            By default the scene's `up`.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Renderer(([[0, 0, 0], [2, 0, 0], [0, 3, 0]], [[0, 1, 2]])) as renderer:
        ...     renderer.measure_views(["front", "right"])
        {'front': (2.0, 3.0), 'right': (0.0, 3.0)}
        """
        up = known_up(self.scene) if up is None else up
        extent = self._find_extent(self.scene)
        return {view: measure_side(extent, view, up) for view in views}

    def list_notes(self, scene: Scene | None = None) -> tuple[str, ...]:
        """Return what the user of a picture without a camera of its own should know: the guessed `up`, strays.

        Parameters
        ----------
        scene : Scene, optional
            The settings of the picture; by default the renderer's.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320)) as renderer:
        ...     renderer.list_notes()
        ()
        """
        scene = self.scene if scene is None else scene
        notes = [self._up_note] if self._up_note is not None and scene.up == self.scene.up else []
        is_framed = scene.look_at is None and not isinstance(scene.projection, Panorama)
        if is_framed and scene.frame == AUTO and (left_out := self._find_bulk().note) is not None:
            notes.append(f"{left_out}; --frame all shows everything")
        return tuple(notes)

    def _find_camera(self, scene: Scene) -> Camera:
        """Return the camera of a scene; the last one is kept, because framing reads all vertices."""
        framed_scene, camera = self._framed
        if _framing_of(scene) != _framing_of(framed_scene):
            self._framed = framed_scene, camera = self._frame(scene)
        return camera

    def _find_ground(self, scene: Scene, camera: Camera) -> Ground | None:
        """Return the ground of a picture that shows one; the last one is kept, because it reads all vertices."""
        if not shows_ground(scene):
            return None
        up = sky_direction(scene, camera)
        extent = self._find_extent(scene)
        if self._ground is None or self._ground[0] is not extent or not np.array_equal(self._ground[1], up):
            self._ground = extent, up, find_ground(extent, up)
        return self._ground[2]

    def _find_bulk(self) -> Bulk:
        if self._bulk is None:
            self._bulk = find_bulk(self._subject.extent)
        return self._bulk

    def _find_extent(self, scene: Scene) -> Mesh | SceneExtent:
        """Return what a camera that shows the whole has to show."""
        return self._find_bulk().extent if scene.frame == AUTO else self._subject.extent

    def _frame(self, scene: Scene) -> tuple[Scene, Camera]:
        return scene, scene.with_changes(frame="all").find_camera(self._find_extent(scene))


def _framing_of(scene: Scene) -> tuple[object, ...]:
    """Return the values of a scene that its camera depends on, beside the mesh."""
    lens = scene.fov, scene.projection, scene.aperture, scene.focus_distance
    return scene.width / scene.height, scene.eye, scene.look_at, scene.up, scene.view, scene.frame, *lens


def _height_of(projection: Projection | None) -> float:
    return projection.height or 0.0 if isinstance(projection, Orthographic) else 0.0
