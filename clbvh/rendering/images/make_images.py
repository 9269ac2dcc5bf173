"""From a scene to its images: one picture, and the channels that follow from it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from ...errors import SceneError
from ...geometry import Shape
from ...support.memory import check_memory
from ..as_scene import SceneLike
from ..camera import Camera
from ..picture import Picture
from ..render_options import RenderOptions
from .channels import CHANNELS, DEFAULT_CHANNELS, Subject, check_channels
from .images import Images
from .motion import NextPose

if TYPE_CHECKING:
    from ..renderer import Renderer

# Hits in float64, and vectors on the way to them.
_PIXEL_BYTES = 100


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
    from ..renderer import Renderer

    check_channels(channels)
    with Renderer(source, options, on_phase=on_phase) as renderer:
        for note in renderer.list_notes() if camera is None else ():
            on_note(note)
        return renderer.images(
            channels, camera=camera, width=width, height=height, shading=shading, samples=samples,
            next_camera=next_camera, next_transforms=next_transforms, on_phase=on_phase,
        )  # fmt: skip


def make_images(
    renderer: Renderer,
    channels: Iterable[str],
    next_camera: Camera | None,
    next_transforms: Mapping[Any, ArrayLike] | None,
    shading: str | None,
    samples: int | None,
    **arguments: Any,
) -> Images:
    """Return the images of `Renderer.images`; `arguments` are those of `Renderer.render`."""
    names = check_channels(channels)
    next_pose = NextPose(renderer.scene, next_camera, next_transforms)
    if "motion" in names:
        next_pose.check()
    if any(CHANNELS[name].needs_shading for name in names):
        keeps_film = "colour" in names or "alpha" in names
        picture = renderer.render(shading=shading, samples=samples, keeps_film=keeps_film, **arguments)
    else:
        # One ray for each pixel, and none to the light.
        picture = renderer.render(shading="normal", samples=1, **arguments)
    pixel_bytes = _PIXEL_BYTES + sum(CHANNELS[name].pixel_bytes for name in names)
    check_memory("the images", picture.found.size * pixel_bytes, SceneError)
    shapes, geometry_names, instance_names = _list_objects(picture)
    subject = Subject(picture, shapes, next_pose, renderer.scene.smooth)
    arrays = {name: CHANNELS[name].find(subject) for name in names}
    return Images(arrays, picture.camera, geometry_names=geometry_names, instance_names=instance_names)


def _list_objects(picture: Picture) -> tuple[tuple[Shape, ...], tuple[str, ...], tuple[str, ...]]:
    """Return the shapes and the names of the geometries, and the names of the instances, by their ids."""
    if picture.mesh is not None:
        return (picture.mesh,), (picture.mesh.name,), (picture.mesh.name,)
    state = picture.objects.state
    return tuple(state.shapes), tuple(state.names), tuple(state.instance_names)
