"""The public class for pictures: one scene and its trees on one device, and any number of pictures of it.

Owns the order of the steps from a scene to a picture; each step has a file of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..bvh import Bvh
from ..device.context import EventTimes
from ..device.info import DeviceInfo
from ..errors import ConfigError, SceneError
from ..geometry import Mesh
from ..structs import REPORT_SHADINGS, VIEW
from ..support.context_manager import ContextManager
from ..support.host_threads import side_by_side
from ..support.memory import check_memory
from ..support.stopwatch import Stopwatch
from ..trace.traced_tree import TracedTree
from .band_painters import Progress
from .cameras.bounds import SceneBounds
from .cameras.camera import Camera
from .cameras.framing import frame_scene, measure_side
from .cameras.projection import AUTO, STANDARD_VIEWS, Orthographic, Panorama, Projection
from .cut import Cut
from .frame import FrameRenderer
from .guesses import Framed, frame_without_outliers, guess_up, known_up
from .open_scene import SceneLike, as_scene
from .options import RenderOptions
from .painters import Painters, open_session
from .picture import Picture, list_picture_ms, list_setup_ms
from .scene import Scene
from .settings import DEFAULT_CHANNELS, MAX_SAMPLES, Light, Wireframe, find_sample_count
from .subjects import MeshSubject, SceneSubject
from .vectors import Vector
from .view import Ground, find_ground, shows_ground, sky_direction

if TYPE_CHECKING:
    from .images.images import Images

# Four channels of float32.
_FILM_BYTES = 16


class Renderer(ContextManager):
    """Renders pictures of one scene on one device; a context manager.

    Meshes, trees and kernels are made once; each picture then costs its kernel and the transfer from the
    device. Any number of threads may use one renderer. A child that was forked cannot: its pictures raise
    `DeviceError`, and closing the renderer there changes nothing.

    Parameters
    ----------
    source : Scene, str, path, Bvh, Mesh, trimesh.Trimesh or (vertices, faces)
        A scene, as it is now; the path or name of one, or the path of a mesh file; a finished tree, which is not built
        again; or a mesh.
    options : RenderOptions, optional
    on_phase : function, optional
        Called with the name of each phase as it begins.

    Raises
    ------
    SceneError, MeshError, ConfigError
        The input cannot be used.
    DeviceError, KernelBuildError, PoolError
        A device, a driver or a worker process fails.
    ValidationError
        The tree is wrong.

    Attributes
    ----------
    scene : Scene
        The arguments of `Renderer.render` replace parts of it for one picture.
    timings : dict of str to float
        Milliseconds from the scene to the tree on the device, as in `Picture.timings`.

    Examples
    --------
    >>> import clbvh
    >>> import numpy as np
    >>> with clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320)) as renderer:
    ...     front = renderer.render(width=64, height=48)
    ...     side = renderer.render(width=64, height=48, camera=front.camera.orbit(90), shading="normal")
    >>> side.rgb.shape
    (48, 64, 3)

    Several objects, with colours of their own:

    >>> scene = clbvh.Scene(width=64, height=48)
    >>> ball = scene.add(clbvh.Spheres([[0, 0, 0]], 1.0))
    >>> left = scene.place(ball, colour=(0.8, 0.1, 0.1))
    >>> right = scene.place(ball, clbvh.Transform(scale=0.5, translate=(2, 0, 0)), colour=(0.1, 0.1, 0.8))
    >>> with clbvh.Renderer(scene) as renderer:
    ...     picture = renderer.render()
    >>> picture
    Picture(64 x 48 of 'spheres', 1,211 pixels hit)
    >>> np.unique(picture.hits.instance_id)
    array([-1,  0,  1], dtype=int32)
    """

    def __init__(
        self,
        source: SceneLike,
        options: RenderOptions | None = None,
        *,
        on_phase: Callable[[str], None] = lambda phase: None,
    ) -> None:
        options = options or RenderOptions()
        if not isinstance(options, RenderOptions):
            raise ConfigError(f"the options must be a clbvh.RenderOptions or None, not {options!r}")
        watch = Stopwatch()
        with ExitStack() as stack:
            self.scene = as_scene(source)
            subject = _find_subject(self.scene, source, options)
            self._subject = subject

            # Side by side: a driver starts, and loads what it has compiled, without Python's lock.
            make_tree = partial(self._make_tree, watch, on_phase)
            _, session = side_by_side(make_tree, partial(open_session, options.device, self.scene.shading))
            # Closed if a step fails, and not at the end of this block.
            on_failure = stack.enter_context(ExitStack())
            on_failure.push(session)
            watch.lap("open")
            self._tree: TracedTree = subject.put(session)
            self._frames = FrameRenderer(session, self._tree)
            self._painters = Painters(session, self._tree, subject)
            watch.lap("layout")
            # So that the first picture takes no longer than the others.
            self._painters.painter(self.scene, np.zeros(1, VIEW), Progress(1))
            upload_ms = session.times.sums_ms()["upload"]
            watch.lap("compile")
            self.timings = list_setup_ms(watch, subject.made, upload_ms)

            if options.validate:
                on_phase("validate")
                subject.validate()
            on_failure.pop_all()
        self._options = options
        self._session = session

    def render(
        self,
        *,
        camera: Camera | None = None,
        view: str | None = None,
        width: int | None = None,
        height: int | None = None,
        shading: str | None = None,
        light: Light | Vector | None = None,
        surface: Vector | None = None,
        background: Vector | tuple[Vector, Vector] | None = None,
        cut: Cut | None = None,
        wireframe: Wireframe | None = None,
        samples: int | None = None,
        time_limit_s: float | None = None,
        on_samples: Callable[[int, int], None] = lambda done, total: None,
        is_stopped: Callable[[], bool] = lambda: False,
        keeps_film: bool = False,
        on_phase: Callable[[str], None] = lambda phase: None,
    ) -> Picture:
        """Render a picture; arguments that are None keep the values of the scene.

        Parameters
        ----------
        camera : Camera, optional
            By default the scene's, which sees the whole mesh unless the scene has an eye.
        view : str, optional
            In place of a camera: the whole mesh from a side, see `Scene.view`.
        width, height : int, pixels
            By default the lens's, or the scene's for a camera without a lens.
        shading : str
            One of `Scene.shading`.
        light : Light, or (3,) float
            A light, or only the direction towards it.
        surface : (3,) float
            Linear colour of the mesh, and of objects without one of their own.
        background : (3,) float, or a pair of them
            Linear colour, or the colours at the top and at the bottom.
        cut : Cut, optional
            A part of the world that the camera does not see.
        wireframe : Wireframe, optional
            Lines along the edges of triangles.
        samples : int, optional
            Of each pixel; see `Scene.samples`.
        time_limit_s : float, optional
            Seconds. No samples are begun after it, but each pixel gets one at least. Without `samples`, as many are
            taken as the time allows.
        on_samples : function, optional
            Called with the samples that are done, and that all pixels are to get, after each launch of the kernel.
        is_stopped : function, optional
            Asked after each launch; if it returns True, the picture shows the samples taken so far.
        keeps_film : bool
            Whether the picture keeps the linear colours of its samples, see `Picture.film`.
        on_phase : function, optional
            Called with the name of each phase as it begins.

        Returns
        -------
        Picture
            Its timings are those of this picture alone.

        Raises
        ------
        SceneError
            A value is out of range, or the aspect ratio is not that of the camera's lens.
        QueryError
            The renderer is closed.
        DeviceError
            The device fails, or this process was forked from one that has used OpenCL.
        ValidationError
            The options ask for a check, and a pixel is wrong.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320)) as renderer:
        ...     picture = renderer.render(width=64, height=48, shading="depth")
        >>> picture.rgb.shape
        (48, 64, 3)
        """
        if camera is not None and not isinstance(camera, Camera):
            raise SceneError(f"the camera must be a clbvh.Camera, not {camera!r}")
        if camera is not None and view is not None:
            raise SceneError(f"a picture has a camera or a view, and both were given: the view '{view}'")
        watch = Stopwatch()
        on_phase("render")
        if camera is not None and camera.lens is not None:
            width, height = camera.size_for(width, height)
        seen = self.scene if view is None else self.scene.with_view(view)
        scene = seen.with_changes(
            width=width,
            height=height,
            shading=shading,
            light=light if light is None or isinstance(light, Light) else self.scene.light.with_direction(light),
            surface=surface,
            background=background,
            cut=cut,
            wireframe=wireframe,
            samples=samples,
        )
        progress = _make_progress(scene, time_limit_s, on_samples, is_stopped)
        if keeps_film and scene.shading not in REPORT_SHADINGS:
            progress.film = _make_film(scene)
        made = self._subject.made
        notes = [] if made is None else [*made.notes]
        if camera is None:
            notes += self.list_notes(scene)
            camera = self._find_camera(scene)
        times = EventTimes()
        framed = self._find_extent(scene)
        device_view = self._subject.make_view(scene, camera, self._find_ground(scene, camera), framed)
        colours, found = self._frames.render(device_view, self._painters.painter(scene, device_view, progress), times)
        rgb = _take_rgb(colours)
        picture = Picture(
            rgb=rgb,
            alpha=colours[..., 3].copy(),
            film=progress.film,
            samples=progress.taken,
            is_transparent=scene.transparent,
            cut=scene.cut,
            found=found,
            camera=camera,
            **self._subject.picture_parts(),
            device=self.device,
            layout=self.layout,
            workers=made.workers if made is not None else int(self._subject.bvh is None),
            timings=list_picture_ms(self.timings, times, watch),
            tree_from_cache=made is not None and made.from_cache,
            notes=tuple(notes),
        )
        if not self._options.validate:
            return picture
        # The reference is large, and few ask for it.
        from .check_pixels import check_pixels

        on_phase("validate")
        return check_pixels(picture)

    def images(
        self,
        channels: Iterable[str] = DEFAULT_CHANNELS,
        *,
        camera: Camera | None = None,
        width: int | None = None,
        height: int | None = None,
        shading: str | None = None,
        samples: int | None = None,
        next_camera: Camera | None = None,
        next_transforms: Mapping[Any, ArrayLike] | None = None,
        on_phase: Callable[[str], None] = lambda phase: None,
    ) -> Images:
        """Return what each pixel of a view sees, as arrays: depth, normals, ids and more; see `render_images`.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320)) as renderer:
        ...     images = [
        ...         renderer.images("depth", camera=camera, width=64, height=48) for camera in renderer.turntable(4)
        ...     ]
        >>> images[3]
        Images(64 x 48: depth)
        """
        from .images.images import make_images  # most pictures need none of it

        return make_images(
            self.scene, self.render, channels, next_camera, next_transforms, shading, samples,
            camera=camera, width=width, height=height, on_phase=on_phase,
        )  # fmt: skip

    def _make_tree(self, watch: Stopwatch, on_phase: Callable[[str], None]) -> None:
        """Find the subject, its upright position, and its tree on the host."""
        on_phase("load")
        self._subject.load()
        self._stand_upright()
        watch.lap("load")

        on_phase("build")
        self._subject.build()
        watch.lap("build")
        on_phase("open the device")

    @property
    def mesh(self) -> Mesh | None:
        """The mesh, in the scene's coordinates; None for a scene of several objects."""
        return self._subject.mesh

    @property
    def bvh(self) -> Bvh | None:
        """The tree of the mesh; None with the builder ``"brute"``, and for a scene of several objects."""
        return self._subject.bvh

    @property
    def device(self) -> DeviceInfo:
        """The device that the tree is on."""
        return self._session.info

    @property
    def layout(self) -> str:
        """The layout of the tree on the device."""
        return self._tree.layout

    @property
    def memory_bytes(self) -> int:
        """Device memory that the tree and the triangles take."""
        return self._tree.memory_bytes

    @property
    def is_closed(self) -> bool:
        """Whether the renderer makes no more pictures."""
        return self._frames.calls.is_closed

    def close(self) -> None:
        """Give the device's memory back. Closing twice is allowed.

        Pictures that other threads are rendering are finished first; later calls raise `QueryError`.

        Examples
        --------
        >>> import clbvh
        >>> renderer = clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320))
        >>> renderer.close()
        >>> renderer.is_closed
        True
        """
        self._frames.close()

    def __repr__(self) -> str:
        name = "scene" if self.mesh is None else self.mesh.name
        return f"Renderer({name!r}, device={self.device.name!r}, layout={self.layout!r})"

    def _stand_upright(self) -> None:
        """Replace the scene's `up` by a direction, and find its camera; the subject must be loaded."""
        self._framed_parts: Framed | None = None
        self._up_note: str | None = None
        if isinstance(self.scene.up, str):
            up, self._up_note = guess_up(self._find_extent(self.scene), self.scene.eye, self.scene.look_at)
            self.scene = self.scene.with_changes(up=up)
        self._framed = self._frame(self.scene)
        self._ground: tuple[SceneBounds, NDArray[np.float64], Ground] | None = None

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
        first = frame_scene(
            self._find_extent(scene),
            turns=True,
            aspect=scene.width / scene.height,
            up=known_up(scene.up),
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
            view: frame_scene(extent, aspect=aspect, up=known_up(scene.up), projection=Orthographic(), side=view)
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
        up = known_up(self.scene.up) if up is None else up
        extent = self._find_extent(self.scene)
        return {view: measure_side(extent, view, up) for view in views}

    def list_notes(self, scene: Scene | None = None) -> tuple[str, ...]:
        """Return what the user of a picture without a camera of its own should know: the guessed `up`, outliers.

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
        if is_framed and scene.frame == AUTO and (left_out := self._leave_out_outliers().note) is not None:
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

    def _leave_out_outliers(self) -> Framed:
        if self._framed_parts is None:
            self._framed_parts = frame_without_outliers(self._subject.extent)
        return self._framed_parts

    def _find_extent(self, scene: Scene) -> SceneBounds:
        """Return what a camera that shows the whole has to show."""
        return self._leave_out_outliers().bounds if scene.frame == AUTO else self._subject.extent

    def _frame(self, scene: Scene) -> tuple[Scene, Camera]:
        return scene, scene.with_changes(frame="all").find_camera(self._find_extent(scene))


def _take_rgb(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the first three of four channels: channel by channel, 14 times as fast as ``colours[..., :3].copy()``."""
    rgb = np.empty((*colours.shape[:2], 3), np.uint8)
    for channel in range(3):
        rgb[..., channel] = colours[..., channel]
    return rgb


def _make_film(scene: Scene) -> NDArray[np.float32]:
    check_memory("the film of the picture", scene.width * scene.height * _FILM_BYTES, SceneError)
    return np.empty((scene.height, scene.width, 4), np.float32)


def _make_progress(
    scene: Scene,
    time_limit_s: float | None,
    on_samples: Callable[[int, int], None],
    is_stopped: Callable[[], bool],
) -> Progress:
    """Return the samples to take of a picture."""
    if time_limit_s is None:
        return Progress(find_sample_count(scene), on_samples=on_samples, is_stopped=is_stopped)
    if isinstance(time_limit_s, bool) or not isinstance(time_limit_s, Real) or not time_limit_s > 0:
        raise SceneError(f"the time limit must be a number of seconds above 0, not {time_limit_s!r}")
    samples = MAX_SAMPLES if scene.samples is None else scene.samples
    return Progress(samples, float(time_limit_s), on_samples, is_stopped)


def _find_subject(scene: Scene, source: SceneLike, options: RenderOptions) -> MeshSubject | SceneSubject:
    """Return what pictures of a scene show."""
    if scene.is_one_mesh:
        return MeshSubject(scene, None, source if isinstance(source, Bvh) else None, options)
    state = scene.snapshot()
    # A mesh that is placed once, where it is, needs no instance, unless it has a colour of its own.
    if state.geometry_count == 1 and state.is_one_mesh and scene.instances[0].colour is None and not state.materials:
        return MeshSubject(scene, cast(Mesh, state.shapes[0]), None, options)
    return SceneSubject(state, options)


def _framing_of(scene: Scene) -> tuple[object, ...]:
    """Return the values of a scene that its camera depends on, beside the mesh."""
    lens = scene.fov, scene.projection, scene.aperture, scene.focus_distance
    return scene.width / scene.height, scene.eye, scene.look_at, scene.up, scene.view, scene.frame, *lens


def _height_of(projection: Projection | None) -> float:
    return projection.height or 0.0 if isinstance(projection, Orthographic) else 0.0
