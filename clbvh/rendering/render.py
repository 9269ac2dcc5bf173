"""One picture of a scene, or its images, from the file to the pixels: a `Renderer` used once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from ..choices import DEFAULT_CHANNELS
from .cameras.camera import Camera
from .open_scene import SceneLike
from .options import RenderOptions
from .picture import Picture
from .renderer import Renderer
from .view import View

if TYPE_CHECKING:
    from .images.images import Images


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
    source : Scene, str, path, trimesh.Scene, Bvh, Spheres, Mesh, trimesh.Trimesh or (vertices, faces)
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
    """Return what each pixel of a view sees, as arrays; `Renderer.images` is faster for several views of one scene.

    Parameters
    ----------
    source : Scene, str, path, trimesh.Scene, Bvh, Spheres, Mesh, trimesh.Trimesh or (vertices, faces)
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
    ...     ball, ("depth", "motion", "primitive_id"), camera=camera, next_camera=moved, width=65, height=65
    ... )
    >>> images["motion"][32, 32].round(2)  # focal length / depth * shift, to the left
    array([-5.15,  0.  ], dtype=float32)
    >>> np.isinf(images["depth"][0, 0]).item(), images["primitive_id"][0, 0].item()
    (True, -1)
    """
    from .images.channels import check_channels

    channels = check_channels(channels)
    with Renderer(source, view, options, on_phase=on_phase, **changes) as renderer:
        images = renderer.images(channels, next_camera=next_camera, next_transforms=next_transforms, on_phase=on_phase)
        for note in renderer.list_notes():
            if on_note is not None:
                on_note(note)
    return images
