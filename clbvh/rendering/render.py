"""One picture of a scene, from the file to the pixels: a `Renderer` used once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from .as_scene import SceneLike
from .camera import Camera
from .cut import Cut
from .picture import Picture
from .render_options import RenderOptions
from .renderer import Renderer
from .scene import Light
from .vectors import Vector
from .wireframe import Wireframe

__all__ = ["RenderOptions", "render"]


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
