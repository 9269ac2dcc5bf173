"""One picture of a scene, or its images, from the file to the pixels: a `Renderer` used once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from .cameras.camera import Camera
from .cut import Cut
from .open_scene import SceneLike
from .options import RenderOptions
from .picture import Picture
from .renderer import Renderer
from .settings import DEFAULT_CHANNELS, Light, Wireframe
from .vectors import Vector

if TYPE_CHECKING:
    from .images.images import Images


def render(
    source: SceneLike,
    options: RenderOptions | None = None,
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
    on_phase: Callable[[str], None] = lambda phase: None,
) -> Picture:
    """Render one picture; a `Renderer` is faster for several pictures of one scene.

    Parameters
    ----------
    source : Scene, str, path, Bvh, Mesh, trimesh.Trimesh or (vertices, faces)
        A scene; the path or name of one, or the path of a mesh file; a finished tree; or a mesh.
    options : RenderOptions, optional
    camera, view, width, height, shading, light, surface, background, cut, wireframe, samples : optional
        See `Renderer.render`; by default the scene's.
    time_limit_s, on_samples, is_stopped : optional
        See `Renderer.render`.
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
    with Renderer(source, options, on_phase=on_phase) as renderer:
        picture = renderer.render(
            camera=camera, view=view, width=width, height=height, shading=shading, light=light, surface=surface,
            background=background, cut=cut, wireframe=wireframe, samples=samples, time_limit_s=time_limit_s,
            on_samples=on_samples, is_stopped=is_stopped, on_phase=on_phase,
        )  # fmt: skip
    timings = {phase: renderer.timings[phase] + ms for phase, ms in picture.timings.items()}
    return replace(picture, timings=timings)


def render_images(
    source: SceneLike,
    channels: Iterable[str] = DEFAULT_CHANNELS,
    options: RenderOptions | None = None,
    *,
    camera: Camera | None = None,
    width: int | None = None,
    height: int | None = None,
    shading: str | None = None,
    samples: int | None = None,
    next_camera: Camera | None = None,
    next_transforms: Mapping[Any, ArrayLike] | None = None,
    on_phase: Callable[[str], None] = lambda phase: None,
    on_note: Callable[[str], None] = lambda note: None,
) -> Images:
    """Return what each pixel of a view sees, as arrays; `Renderer.images` is faster for several views of one scene.

    Parameters
    ----------
    source : Scene, str, path, Bvh, Mesh, trimesh.Trimesh or (vertices, faces)
        See `render`.
    channels : iterable of str
        See `Images`.
    options : RenderOptions, optional
    camera : Camera, optional
        Also one of `Camera.from_intrinsics`; by default the scene's.
    width, height : int, pixels
        See `Renderer.render`.
    shading : str, optional
        Of the channels `rgb`, `colour` and `alpha`; by default the scene's.
    samples : int, optional
        Of each pixel in these channels; by default the scene's. The others are those of the pixel's centre.
    next_camera : Camera, optional
        For the channel `motion`: the camera of the second pose, for a picture of the same size.
    next_transforms : mapping of instances, ids or names to (4, 4) float, optional
        For the channel `motion`: the transforms of instances in the second pose, as `Scene.place` takes them.
    on_phase : function, optional
        Called with the name of each phase as it begins.
    on_note : function, optional
        Called with each fact that a user should know, as in `Picture.notes`.

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

    check_channels(channels)
    with Renderer(source, options, on_phase=on_phase) as renderer:
        for note in renderer.list_notes() if camera is None else ():
            on_note(note)
        return renderer.images(
            channels, camera=camera, width=width, height=height, shading=shading, samples=samples,
            next_camera=next_camera, next_transforms=next_transforms, on_phase=on_phase,
        )  # fmt: skip
