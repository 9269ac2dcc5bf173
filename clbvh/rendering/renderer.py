"""The public class for pictures: one scene and its trees on one device, and any number of pictures of it.

Owns the order of the steps from a scene and a view to a picture; each step has a file of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..bvh import Bvh
from ..choices import DEFAULT_CHANNELS, LIT_SHADINGS, REPORT_SHADINGS, STANDARD_VIEWS
from ..device.info import DeviceInfo
from ..device.session import DeviceSession
from ..device.times import CommandTimes
from ..errors import ConfigError, QueryError, SceneError
from ..files.open_scene import SceneLike, as_scene
from ..geometry import Mesh
from ..scene.handles import Instances, shorten
from ..structs import VIEW
from ..support.context_manager import ContextManager
from ..support.forks import make_lock
from ..support.host_threads import side_by_side
from ..support.memory import check_memory
from ..support.stopwatch import Stopwatch, add_total
from ..trace.hits.hits import Hits
from ..trace.launch import Caster
from ..trace.tracer import Opening, Plans, Tracer
from ..views.cameras.camera import Camera
from ..views.cameras.projection import Fisheye
from ..views.ground import is_lit_as_studio
from ..views.view import MAX_SAMPLES, View
from ..views.view_finder import ViewFinder
from .drawn_scene import DrawnScene
from .frame import develop_film, render_frame
from .joined_scene import JoinedScene, JoinedScenes
from .kernel_view import make_kernel_view
from .options import RenderOptions
from .painters import Painters, open_session
from .picture import Picture, refine_pixels
from .progress import LAUNCH_S, Progress

if TYPE_CHECKING:
    from .images import Images

# Four channels of float32.
_FILM_BYTES = 16


class _Drawn(NamedTuple):
    """What a renderer draws: a picture reads it once, because a move replaces it."""

    caster: Caster
    scene: DrawnScene
    finder: ViewFinder
    painters: Painters
    joined: JoinedScenes

    @classmethod
    def of_tracer(cls, tracer: Tracer, session: DeviceSession, before: _Drawn | None = None) -> Self:
        """Return what a tracer is at; `session` owns what its pictures need beside the world."""
        caster = tracer._caster
        scene = DrawnScene.of_world(caster.world, tracer._opening)
        painters = before.painters.at(caster.world, scene) if before else Painters(session, caster.world, scene)
        return cls(caster, scene, ViewFinder(scene.bounds), painters, JoinedScenes(session, caster, scene))


class Renderer(ContextManager):
    """Renders pictures of one scene on one device; a context manager.

    Meshes, trees and kernels are made once; each picture then costs its kernel and the transfer from the
    device. Any number of threads may use one renderer, and so may forked children on the host. On a device of
    OpenCL they cannot: their pictures raise `DeviceError`, and closing the renderer there changes nothing.

    Pictures are cast at the world of a tracer. A renderer of a `Tracer` shares its trees, and shows it as it is now:
    what moves there moves in later pictures. Any other source gets a tracer of its own, which is `tracer`.

    Renderers pickle as their tracers do, which open again where they arrive, once in each process.

    Parameters
    ----------
    source : Tracer, Scene, str, path, Bvh, Spheres, Mesh, (vertices, faces), or an object of trimesh, pyvista, ...
        An open tracer; a scene, as it is now; the path or name of one, or the path of a mesh file; a finished tree,
        which is not built again; or a mesh, see `clbvh.MeshLike`.
    view : View, optional
        The settings of pictures that ask for no others. By default those of the scene file, or those of `View()`.
    options : RenderOptions, optional
        Of a tracer only `validate`: it has a device, a layout and trees.
    on_phase : function, optional
        Called with the name of each phase as it begins.
    **changes
        Settings of `View`, in place of those of the view.

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
    tracer : Tracer
        Casts rays at what the pictures show.
    scene : Scene
    view : View
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

    >>> scene = clbvh.Scene()
    >>> ball = scene.add(clbvh.Spheres([[0, 0, 0]], 1.0))
    >>> left = scene.place(ball, colour=(0.8, 0.1, 0.1))
    >>> right = scene.place(ball, clbvh.Transform(scale=0.5, translate=(2, 0, 0)), colour=(0.1, 0.1, 0.8))
    >>> with clbvh.Renderer(scene, clbvh.View(width=64, height=48)) as renderer:
    ...     picture = renderer.render()
    >>> picture
    Picture(64 x 48 of 'spheres', 1,211 pixels hit)
    >>> np.unique(picture.hits.instance_id)
    array([-1,  0,  1], dtype=int32)
    """

    _is_closed = False
    _drawn: _Drawn

    def __init__(
        self,
        source: Tracer | SceneLike | list[str],
        view: View | None = None,
        options: RenderOptions | None = None,
        *,
        on_phase: Callable[[str], None] | None = None,
        **changes: Any,
    ) -> None:
        _check_type("view", view, View)
        _check_type("options", options, RenderOptions)
        self._options = options or RenderOptions()
        enter, watch = on_phase or _ignore, Stopwatch()
        # A wrong setting is found before any work.
        guessed = (view or View()).changed(**changes)
        # Closed if a step fails, and not at the end of this block.
        with ExitStack() as on_failure:
            self._owns_tracer = not isinstance(source, Tracer)
            if isinstance(source, Tracer):
                if replace(self._options, validate=False) != RenderOptions():
                    raise ConfigError("a tracer has its device, its layout and its trees: give a renderer none of them")
                source._caster.calls.check_open()
                self.tracer, own_view = source, View()
            else:
                self.tracer, own_view = self._open_tracer(source, guessed.shading, enter, watch)
                on_failure.push(self.tracer)
            self.scene = self.tracer._opening.scene
            self.view = (own_view if view is None else view).changed(**changes)
            self._lock = make_lock()
            self._session = self.tracer._caster.session.branch()
            self._drawn = _Drawn.of_tracer(self.tracer, self._session)
            # What is uploaded later belongs to the phase in which it is.
            upload_ms = self.tracer.timings_ms["upload"] if self._owns_tracer else 0.0
            watch.lap("layout")
            # So that the first picture takes no longer than the others.
            joined = self._drawn.joined.find(self._drawn.finder.complete(self.view))
            (joined or self._drawn).painters.painter(self.view, np.zeros(1, VIEW), Progress(1))
            watch.lap("compile")
            laps_ms, built = watch.laps_ms, self.tracer._opening.built
            phases_ms = {
                "load": laps_ms.get("load", 0.0),
                **(dict.fromkeys(("cache", "build"), 0.0) if built is None else built.timings_ms),
                "open": laps_ms.get("open", 0.0),
                # The tree is uploaded as it is arranged; the upload has a row of its own.
                "layout": max(laps_ms["layout"] - upload_ms, 0.0),
                "compile": laps_ms["compile"],
                "upload": upload_ms,
                **dict.fromkeys(("kernel", "download"), 0.0),
            }
            self.timings = add_total(phases_ms, watch.total_ms)
            if self._options.validate:
                enter("validate")
                self._validate(self._drawn.scene)
            on_failure.pop_all()

    def _open_tracer(
        self, source: SceneLike | list[str], shading: str, enter: Callable[[str], None], watch: Stopwatch
    ) -> tuple[Tracer, View]:
        """Return a tracer of a source, and the view that comes with it."""
        options = self._options

        def plan_world() -> tuple[View, Opening, Plans]:
            """Open the source, and build its trees on the host."""
            enter("load")
            scene, view = as_scene(source)
            watch.lap("load")
            enter("build")
            tree = source if isinstance(source, Bvh) else None
            opening, plans = Opening.plan(scene, tree, options.device, options.chosen_layout, options)
            watch.lap("build")
            enter("open the device")
            return view, opening, plans

        # Side by side: a driver starts, and loads what it has compiled, without Python's lock.
        (view, opening, plans), session = side_by_side(plan_world, partial(open_session, options.device, shading))
        watch.lap("open")
        return Tracer._opened(opening, plans, session), view

    def render(
        self,
        view: View | None = None,
        *,
        time_limit_s: float | None = None,
        on_samples: Callable[[int, int], None] | None = None,
        is_stopped: Callable[[], bool] | None = None,
        keeps_film: bool = False,
        launch_s: float = LAUNCH_S,
        on_phase: Callable[[str], None] | None = None,
        **changes: Any,
    ) -> Picture:
        """Render a picture.

        Parameters
        ----------
        view : View, optional
            By default that of the renderer.
        time_limit_s : float, optional
            Seconds. No samples are begun after it, but each pixel gets one at least. Without `samples`, as many are
            taken as the time allows.
        on_samples : function, optional
            Called with the samples that are done, and that all pixels are to get, after each launch of the kernel. An
            error that it raises ends the picture.
        is_stopped : function, optional
            Asked after each launch; if it returns True, the picture shows the samples taken so far.
        keeps_film : bool
            Whether the picture keeps the linear colours of its samples, see `Picture.film`.
        launch_s : float
            Seconds that a launch takes, about, where a device is shared or a picture is to end soon; less is slower.
        on_phase : function, optional
            Called with the name of each phase as it begins.
        **changes
            Settings of `View`, in place of those of the view: ``width=640``, ``camera=camera``, ``light_colour=...``.

        Returns
        -------
        Picture
            Its timings are those of this picture alone.

        Raises
        ------
        SceneError
            There is no such setting, a value is out of range, or the aspect ratio is not that of the camera's lens.
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
        watch, enter = Stopwatch(), on_phase or _ignore
        enter("render")
        given = self._find_view(view, changes)
        drawn = self._look()
        scene, finder = drawn.scene, drawn.finder
        view = finder.complete(given)
        camera = finder.camera(view)
        is_studio_lit = is_lit_as_studio(view, camera, finder.bounds(view)) and not scene.has_lamps
        if is_studio_lit:
            # A ground would hide what is behind a transparent picture.
            has_ground = not view.transparent if view.ground is None else view.ground
            view = replace(view, ground=has_ground, tone_curve=view.tone_curve or "linear")
        is_number = isinstance(time_limit_s, Real) and not isinstance(time_limit_s, bool)
        if time_limit_s is not None and not (is_number and time_limit_s > 0):
            raise SceneError(f"the time limit must be a number of seconds above 0, not {time_limit_s!r}")
        has_end = time_limit_s is None or view.samples is not None
        limit_s = np.inf if time_limit_s is None else float(time_limit_s)
        count = view.sample_count if has_end else MAX_SAMPLES
        progress = Progress(
            count, limit_s, is_stopped or bool, launch_s=launch_s, on_samples=on_samples or _ignore, noise=view.noise
        )
        is_denoised = view.denoise and view.shading in LIT_SHADINGS
        if is_denoised:
            # Few pictures need these.
            from .channels import find_shading_normals
            from .denoise import import_denoiser

            import_denoiser()
        progress.is_apart = is_denoised
        if (keeps_film or is_denoised) and view.shading not in REPORT_SHADINGS:
            check_memory("the film of the picture", view.width * view.height * _FILM_BYTES, SceneError)
            progress.film = np.empty((view.height, view.width, 4), np.float32)
        times = CommandTimes()
        joined = drawn.joined.find(view)
        traced = joined or drawn
        space, ground = traced.scene.space, finder.ground(view, camera)
        boxes = scene.bounds.box_in(space), ground, finder.bounds(view).box_in(space)
        kernel_view = make_kernel_view(view, camera, space, *boxes, is_studio_lit)
        painter = traced.painters.painter(view, kernel_view, progress)
        colours, found = render_frame(traced.caster, kernel_view, painter, progress, times)
        if joined is not None:
            found = joined.as_world_hits(found)
        if is_denoised:
            assert progress.film is not None
            hits = refine_pixels(scene.surface, camera, found)
            normals = find_shading_normals(hits, scene.state.shapes, view.smooth)
            colours = self._denoise(progress.film, normals, view, kernel_view, traced)
        rgb = np.empty((*found.shape, 3), np.uint8)
        for channel in range(3):  # 14 times as fast as colours[..., :3].copy()
            rgb[..., channel] = colours[..., channel]
        own_ms, built = times.sums_ms(), self.tracer._opening.built if scene.trees else None
        picture = Picture(
            rgb=rgb,
            alpha=colours[..., 3].copy(),
            film=progress.film if keeps_film else None,
            samples=progress.taken,
            is_transparent=view.transparent,
            cut=view.cut,
            found=found,
            camera=camera,
            scene=scene,
            device=self.device,
            layout=self.layout,
            workers=0 if built is None else built.workers,
            timings=add_total({phase: own_ms.get(phase, 0.0) for phase in [*self.timings][:-2]}, watch.total_ms),
            tree_from_cache=built is not None and built.from_cache,
            notes=(*(built.notes if built is not None else ()), *scene.notes, *finder.notes(given)),
        )
        if not self._options.validate:
            return picture
        # The reference is large, and few ask for it.
        from .check_pixels import check_pixels

        enter("validate")
        return check_pixels(picture)

    def _denoise(
        self, film: NDArray[np.float32], normals: NDArray[np.float64], view: View, kernel_view: NDArray[np.void],
        traced: _Drawn | JoinedScene,
    ) -> NDArray[np.uint8]:  # fmt: skip
        """Take the noise out of a film of the picture of a view, in place; return its colours."""
        from .denoise import GUIDE_SAMPLES, denoise_film

        guide = Progress(GUIDE_SAMPLES, film=np.empty_like(film))
        plain = traced.painters.painter(replace(view, shading="albedo"), kernel_view, guide)
        render_frame(traced.caster, kernel_view, plain, guide)
        assert guide.film is not None
        denoise_film(film, guide.film, normals)
        return develop_film(traced.caster, kernel_view, film)

    def images(
        self,
        channels: Iterable[str] = DEFAULT_CHANNELS,
        view: View | None = None,
        *,
        next_camera: Camera | None = None,
        next_transforms: Mapping[Any, ArrayLike] | None = None,
        on_phase: Callable[[str], None] | None = None,
        **changes: Any,
    ) -> Images:
        """Return images of a view for programs: depth, normals, ids and more; see `render_images`.

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
        from .images import make_images  # most pictures need none of it

        second = self.scene, next_camera, next_transforms
        return make_images(self.render, self._find_view(view, changes), channels, second, on_phase)

    def set_transforms(self, instances: Instances, transforms: ArrayLike) -> None:
        """Move instances of the scene: later pictures are those of a new renderer of the moved scene, to the last bit.

        Only the tree over the instances is built anew, and the table of the lights that move; for
        the shading `path` also the tree over all triangles, of up to a million.

        Parameters
        ----------
        instances : Instance, int or str, or several
            Those to move, by handle, id or name. The others stay where they are.
        transforms : (n, 4, 4) float, or Transform
            From the coordinates of each instance's geometry to the scene's; (4, 4) for one.

        Raises
        ------
        SceneError
            No such instance, one of another scene, or one that was placed after the renderer was opened; a matrix that
            is not finite, not affine, or singular; or an instance that is too small beside the scene.
        QueryError
            The renderer is closed.
        DeviceError
            The device refuses, or this process was forked from one that has used OpenCL.

        Notes
        -----
        A picture that another thread is rendering ends on the scene that it began with, and keeps its hits. `scene`
        does not change. A view without a camera, or with a guessed `up`, frames the scene as it is now: for a film,
        give one camera to all pictures.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene()
        >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320))
        >>> link, base = scene.place(ball, name="link"), scene.place(ball, name="base")
        >>> with clbvh.Renderer(scene, width=64, height=48, eye=(0, 0, 9), look_at=(0, 0, 0)) as renderer:
        ...     before = renderer.render().report()["hits"]
        ...     renderer.set_transforms("link", clbvh.Transform(translate=(2, 0, 0)))
        ...     before, renderer.render().report()["hits"]
        (216, 440)
        """
        self._check_open()
        self.tracer.set_transforms(instances, transforms)

    def _check_open(self) -> None:
        if self.is_closed:
            raise QueryError("the renderer is closed: its tree is no longer on the device")

    def _look(self) -> _Drawn:
        """Return what the tracer is at now."""
        with self._lock:
            self._check_open()
            if self._drawn.caster.world is not self.tracer._caster.world:
                drawn = _Drawn.of_tracer(self.tracer, self._session, self._drawn)
                if self._options.validate:
                    self._validate(drawn.scene)
                self._drawn = drawn
            return self._drawn

    def _validate(self, scene: DrawnScene) -> None:
        """Raise `ValidationError` unless the trees of a scene are right."""
        from ..builders.build import leaf_limit

        options = self._options
        scene.validate(None if self.tracer._opening.built is None else leaf_limit(options.builder, options.build))

    @property
    def mesh(self) -> Mesh | None:
        """The mesh, in the scene's coordinates; None for a scene of several objects."""
        return self._look().scene.mesh

    @property
    def bvh(self) -> Bvh | None:
        """The tree of the mesh as it was built for the renderer; None for a scene of several objects, and of a tracer.

        Also None with the builder ``"brute"``, and once vertices have moved.
        """
        return self._look().scene.bvh

    @property
    def device(self) -> DeviceInfo:
        """The device that the tree is on."""
        return self.tracer.device

    @property
    def layout(self) -> str:
        """The layout of the tree on the device."""
        return self.tracer.layout

    @property
    def memory_bytes(self) -> int:
        """Device memory that the tree and the triangles take."""
        return self.tracer.memory_bytes

    @property
    def is_closed(self) -> bool:
        """Whether the renderer makes no more pictures."""
        return self._is_closed or self.tracer.is_closed

    def close(self) -> None:
        """Give the device's memory back. Closing twice is allowed.

        Pictures that other threads are rendering are finished first; later calls raise `QueryError`. A tracer that the
        renderer was given stays open; closing that closes the renderer.

        Examples
        --------
        >>> import clbvh
        >>> renderer = clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320))
        >>> renderer.close()
        >>> renderer.is_closed
        True
        """
        self._is_closed = True
        if self._owns_tracer:
            self.tracer.close()
        # What pictures need beside the world is given back when nothing refers to it.
        with self._lock:
            vars(self).pop("_drawn", None)

    def __reduce__(self) -> tuple[Any, ...]:
        if self.is_closed:
            raise QueryError("a closed renderer cannot be pickled: pickle it before, or what it was opened from")
        return _reopen, (self.tracer, self.view, self._options.validate)

    def _repr_png_(self) -> bytes:
        """Return the picture of the renderer's view, for notebooks."""
        return self.render()._repr_png_()

    def __repr__(self) -> str:
        if self.is_closed:
            return "Renderer(closed)"
        scene = self._look().scene
        counts = scene.state._describe()
        return f"Renderer({scene.name!r}, {counts}, device={self.device.name!r}, layout={self.layout!r})"

    @property
    def camera(self) -> Camera:
        """The camera of the renderer's view."""
        return self.find_camera()

    def find_camera(self, view: View | None = None, **changes: Any) -> Camera:
        """Return the camera of a view, by default the renderer's: its own, or the one that its settings choose.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320)) as renderer:
        ...     renderer.find_camera(side="top").up
        (-0.0, -0.0, -1.0)
        """
        finder = self._look().finder
        return finder.camera(finder.complete(self._find_view(view, changes)))

    def hits_at(self, pixels: ArrayLike, view: View | None = None, **changes: Any) -> Hits:
        """Return what points of a picture show, without rendering it.

        Parameters
        ----------
        pixels : (..., 2) float, pixels
            See `Camera.rays_at`: (0.5, 0.5) is the centre of the first pixel.
        view : View, optional
            By default that of the renderer.
        **changes
            Settings of `View`, in place of those of the view.

        Returns
        -------
        Hits
            In the shape (...), as `Tracer.closest_hit` returns them; a cut takes its part away.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320)) as renderer:
        ...     hits = renderer.hits_at([[400, 225], [0, 0]], side="front")
        >>> hits.is_hit
        array([ True, False])
        """
        finder = self._look().finder
        view = finder.complete(self._find_view(view, changes))
        camera, size = finder.camera(view), (view.width, view.height)
        origins, directions = camera.rays_at(pixels, *size)
        if view.cut is None and not isinstance(camera.projection, Fisheye):
            return self.tracer.closest_hit(origins, directions)
        is_seen: Any = True
        if isinstance(camera.projection, Fisheye):  # outside its circle there are rays, too
            column, row = np.moveaxis(np.clip(pixels, 0, np.subtract(size, 1)).astype(int), -1, 0)
            is_seen = camera.sees(*size)[row, column]

        def cast(t_min: ArrayLike = 0.0, t_max: ArrayLike = np.inf) -> Hits:
            t_min, t_max = np.where(is_seen, t_min, 0.0), np.where(is_seen, t_max, 0.0)
            return self.tracer.closest_hit(origins, directions, t_min=t_min, t_max=t_max)

        if view.cut is None:
            return cast()
        begin, end = view.cut.ranges(origins, directions)
        is_before = cast(t_max=np.where(begin <= end, begin, np.inf)).is_hit
        hits = cast(np.where(is_before, 0.0, np.maximum(end, 0.0)), np.where(is_before & (begin <= end), begin, np.inf))
        return replace(hits, t=view.cut.limit(np.asarray(hits.t, np.float64), origins, directions))

    def turntable(self, count: int, view: View | None = None, **changes: Any) -> list[Camera]:
        """Return the cameras of a full turn, which all see the whole scene from the same distance.

        Parameters
        ----------
        count : int
            Cameras, at equal angles; the last one is one step before the first.
        view : View, optional
            By default that of the renderer. The axis of the turn is its `up`, through the middle of the scene's box.
        **changes
            Settings of `View`, in place of those of the view.

        Raises
        ------
        SceneError
            A value is out of range, or the projection is a panorama, which has no turn.

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
        finder = self._look().finder
        return finder.turn(finder.complete(self._find_view(view, changes)), int(count))

    def measure_views(self, views: Sequence[str] = STANDARD_VIEWS, **changes: Any) -> dict[str, tuple[float, float]]:
        """Return the width and the height of the whole scene, seen without perspective from each side.

        Parameters
        ----------
        views : sequence of str
            See `View.side`.
        **changes
            Settings of `View`, in place of those of the renderer: `up` and `frame` count.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Renderer(([[0, 0, 0], [2, 0, 0], [0, 3, 0]], [[0, 1, 2]])) as renderer:
        ...     renderer.measure_views(["front", "right"])
        {'front': (2.0, 3.0), 'right': (0.0, 3.0)}
        """
        finder = self._look().finder
        view = finder.complete(self._find_view(None, changes))
        return {side: finder.measure(view, side) for side in views}

    def list_notes(self, view: View | None = None, **changes: Any) -> tuple[str, ...]:
        """Return notes on a view: the guessed `up`, outliers, a cut that cuts nothing.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Renderer(clbvh.make_shape("icosphere", triangles=320)) as renderer:
        ...     renderer.list_notes()
        ()
        """
        drawn = self._look()
        return (*drawn.scene.notes, *drawn.finder.notes(self._find_view(view, changes)))

    def _find_view(self, view: View | None, changes: Mapping[str, Any]) -> View:
        _check_type("view", view, View)
        return (self.view if view is None else view).changed(**changes)


def _reopen(tracer: Tracer, view: View, validate: bool) -> Renderer:
    """Return a renderer that was pickled."""
    renderer = Renderer(tracer, view, RenderOptions(validate=validate))
    renderer._owns_tracer = True
    return renderer


def _check_type(name: str, value: object, kind: type) -> None:
    if value is not None and not isinstance(value, kind):
        raise ConfigError(f"{name} must be a clbvh.{kind.__name__} or None, not {shorten(value)}")


def _ignore(*_: object) -> None:
    pass


def render(
    source: SceneLike | list[str],
    view: View | None = None,
    options: RenderOptions | None = None,
    *,
    time_limit_s: float | None = None,
    on_samples: Callable[[int, int], None] | None = None,
    is_stopped: Callable[[], bool] | None = None,
    on_phase: Callable[[str], None] | None = None,
    **changes: Any,
) -> Picture:
    """Render one picture; a `Renderer` is faster for several pictures of one scene.

    Parameters
    ----------
    source : Scene, str, path, Bvh, Spheres, Mesh, (vertices, faces), or an object of trimesh, pyvista, Open3D, meshio
        A scene; the path or name of one, or the path of a mesh file; a finished tree; or a mesh. A list of paths of
        mesh files is a scene of them all.
    view : View, optional
        By default that of the scene file, or `View()`.
    options : RenderOptions, optional
    time_limit_s, on_samples, is_stopped : optional
        See `Renderer.render`.
    on_phase : function, optional
        Called with the name of each phase as it begins.
    **changes
        Settings of `View`, in place of those of the view: ``width=640``, ``shading="path"``, ``light_colour=...``.

    Returns
    -------
    Picture

    Raises
    ------
    SceneError, MeshError, ConfigError
        The input cannot be used, or there is no such setting.
    DeviceError, KernelBuildError, PoolError
        A device, a driver or a worker process fails.
    ValidationError
        The tree or a pixel is wrong.

    Examples
    --------
    >>> import clbvh
    >>> picture = clbvh.render(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
    >>> picture.rgb.shape
    (48, 64, 3)
    >>> picture.hits.count
    1565
    """
    with Renderer(source, view, options, on_phase=on_phase, **changes) as renderer:
        picture = renderer.render(
            time_limit_s=time_limit_s, on_samples=on_samples, is_stopped=is_stopped, on_phase=on_phase
        )
    timings = {phase: renderer.timings[phase] + ms for phase, ms in picture.timings.items()}
    return replace(picture, timings=timings)


def render_images(
    source: SceneLike | list[str],
    channels: Iterable[str] = DEFAULT_CHANNELS,
    view: View | None = None,
    options: RenderOptions | None = None,
    *,
    next_camera: Camera | None = None,
    next_transforms: Mapping[Any, ArrayLike] | None = None,
    on_phase: Callable[[str], None] | None = None,
    on_note: Callable[[str], None] | None = None,
    **changes: Any,
) -> Images:
    """Return images of a view for programs, as arrays; `Renderer.images` is faster for several views of one scene.

    Parameters
    ----------
    source : Scene, str, path, Bvh, Spheres, Mesh, (vertices, faces), or an object of trimesh, pyvista, Open3D, meshio
        See `render`.
    channels : iterable of str
        See `Images`.
    view : View, optional
        By default that of the scene file, or `View()`. Its shading and its samples are those of the channels `rgb`,
        `colour` and `alpha`; the others are those of the pixel's centre.
    options : RenderOptions, optional
    next_camera : Camera, optional
        For the channel `motion`: the camera of the second pose, for a picture of the same size.
    next_transforms : mapping of instances, ids or names to (4, 4) float, optional
        For the channel `motion`: the transforms of instances in the second pose, as `Scene.place` takes them.
    on_phase : function, optional
        Called with the name of each phase as it begins.
    on_note : function, optional
        Called with each fact that a user should know, as in `Picture.notes`.
    **changes
        Settings of `View`, in place of those of the view.

    Returns
    -------
    Images

    Raises
    ------
    ConfigError
        A channel that does not exist, or `motion` without a second pose.
    SceneError, MeshError
        The input cannot be used, or the images do not fit the free memory.
    DeviceError, KernelBuildError, PoolError
        A device, a driver or a worker process fails.

    Examples
    --------
    >>> import clbvh
    >>> import numpy as np
    >>> ball = clbvh.make_shape("icosphere", triangles=5120)
    >>> camera, moved = (clbvh.Camera(eye=(x, 0, 3), look_at=(x, 0, 0)) for x in (0.0, 0.1))
    >>> images = clbvh.render_images(
    ...     ball, ("depth", "motion", "prim_id"), camera=camera, next_camera=moved, width=65, height=65
    ... )
    >>> images["motion"][32, 32].round(2)  # focal length / depth * shift, to the left
    array([-5.15,  0.  ], dtype=float32)
    >>> np.isinf(images["depth"][0, 0]).item(), images["prim_id"][0, 0].item()
    (True, -1)
    """
    from .channels import check_channels

    channels = check_channels(channels)
    with Renderer(source, view, options, on_phase=on_phase, **changes) as renderer:
        images = renderer.images(channels, next_camera=next_camera, next_transforms=next_transforms, on_phase=on_phase)
        for note in renderer.list_notes():
            if on_note is not None:
                on_note(note)
    return images
