"""The images of one view, as arrays by the names of their channels, and how they follow from a picture."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ConfigError, SceneError
from ...scene.scene import Scene
from ...support.files import write_atomically
from ...support.memory import check_memory
from ..cameras.camera import Camera
from ..picture import Picture
from ..view import View
from .channels import CHANNELS, NextPose, Subject, check_channels
from .files import (
    FILES_SUFFIXES,
    check_file_targets,
    check_images_path,
    list_exr_channels,
    write_image_files,
    write_images_exr,
)


@dataclass(frozen=True, eq=False, repr=False)
class Images(Mapping[str, NDArray[Any]]):
    """What each pixel of one view sees: a mapping of channels to arrays of (height, width) or (height, width, k).

    All but the colours and alpha belong to the centre of each pixel: they are never mixed of several surfaces. They are
    computed in float64 on the file's own vertices, like every hit.

    | channel | array | a miss holds |
    |---|---|---|
    | rgb | (h, w, 3) uint8: the picture, sRGB | the background |
    | colour | (h, w, 3) float32: the picture, linear, before exposure and tone curve | the background |
    | alpha | (h, w) float32: the share of the pixel that is covered | 0 |
    | depth | (h, w) float32: distance along the optical axis, the z of depth cameras | inf |
    | range | (h, w) float32: distance along the ray, the t of hits | inf |
    | normal | (h, w, 3) float32: of the primitive, of length 1, towards the camera, the scene's axes | 0 |
    | normal_camera | the same along the camera's axes: x right, y down, z forward, as in OpenCV | 0 |
    | shading_normal, shading_normal_camera | the file's at vertices, or smooth ones | 0 |
    | position | (h, w, 3) float64: the scene's coordinates | NaN |
    | instance_id, geometry_id, primitive_id | (h, w) int32 | -1 |
    | barycentric | (h, w, 2) float32: u and v of hits | NaN |
    | uv | (h, w, 2) float32: texture coordinates, (0, 0) at the lower left | NaN, also without such coordinates |
    | motion | (h, w, 2) float32: pixels to the right and downwards, to the second pose | NaN, also behind the camera |

    Attributes
    ----------
    camera : Camera
    geometry_names, instance_names : tuple of str
        By their ids.

    Examples
    --------
    >>> import clbvh
    >>> ball = clbvh.make_shape("icosphere", triangles=5120)
    >>> camera = clbvh.Camera(eye=(0, 0, 3), look_at=(0, 0, 0))
    >>> images = clbvh.render_images(ball, ("depth", "normal_camera"), camera=camera, width=65, height=65)
    >>> images
    Images(65 x 65: depth, normal_camera)
    >>> images["depth"][32, 32].round(2).item(), images["normal_camera"][32, 32].round(1) + 0
    (2.0, array([ 0.,  0., -1.], dtype=float32))
    """

    _arrays: dict[str, NDArray[Any]]
    camera: Camera
    geometry_names: tuple[str, ...] = field(kw_only=True)
    instance_names: tuple[str, ...] = field(kw_only=True)

    def __getitem__(self, channel: str) -> NDArray[Any]:
        if channel not in self._arrays:
            raise KeyError(f"the images have the channels {', '.join(self._arrays)}, not {channel!r}")
        return self._arrays[channel]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        return f"Images({self.width} x {self.height}: {', '.join(self)})"

    @property
    def height(self) -> int:
        """Rows of the images."""
        return next(iter(self._arrays.values())).shape[0]

    @property
    def width(self) -> int:
        """Columns of the images."""
        return next(iter(self._arrays.values())).shape[1]

    @property
    def camera_to_world(self) -> NDArray[np.float64]:
        """(4, 4) float64: the pose of the camera with the axes of OpenCV; see `Camera.from_intrinsics`."""
        return self.camera.camera_to_world("opencv")

    @property
    def intrinsics(self) -> NDArray[np.float64] | None:
        """(3, 3) float64, pixels: the camera's matrix; None for a camera that has none."""
        try:
            return self.camera.intrinsics(self.width, self.height)
        except SceneError:
            return None

    def save(self, path: str | os.PathLike[str], *, depth_scale: float | None = None) -> None:
        """Write all channels to one ``.exr`` or ``.npz`` file, or each to a ``.png`` or ``.ppm`` file of its own.

        Parameters
        ----------
        path : str or path
            The suffix decides:

            - ``.npz``: each array by the name of its channel, bit for bit, and `camera_to_world`, `intrinsics`,
              `size` (width, height), `geometry_names`, `instance_names`.
            - ``.exr``: float32 and uint32, in layers: R, G, B (`colour`), A, depth.Z, normal.X and so on; ids are
              uint32 with 4294967295 on a miss. `position` is rounded to float32; `rgb` is left out, `colour` has it.
              Camera and names stand in the head. Needs OpenEXR.
            - ``.png``: `out.png` stands for out-depth.png, out-normal.png and so on, with 16 bits but for `rgb` and
              `alpha`, and out.json, which has the camera, the names, and for each channel `scale` and `offset`:
              ``value = pixel / scale + offset``; pixel 0 is a miss. A pair has a third channel, 1 on a hit. Ids
              beyond 65534 have 8 bits: the pixel is ``R + 256 G + 65536 B``.
            - ``.ppm``: the same without compression.
        depth_scale : float, optional
            Of `depth` and `range` in PNG and PPM files: pixel values for a unit of length, 1000 for millimetres where
            the unit is the metre. By default the largest of 1, 2, 5, 10, 20 and so on (or 0.5, 0.2, ...) that fits.

        Raises
        ------
        ConfigError
            Another suffix, a file that cannot be written, a channel that the format cannot hold, a depth that
            `depth_scale` makes larger than 65535, or OpenEXR is not installed.

        Examples
        --------
        >>> import clbvh
        >>> import tempfile
        >>> import numpy as np
        >>> from pathlib import Path
        >>> images = clbvh.render_images(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     images.save(Path(folder, "ball.npz"))
        ...     images.save(Path(folder, "ball.png"), depth_scale=1000)
        ...     with np.load(Path(folder, "ball.npz")) as loaded:
        ...         print(bool((loaded["depth"] == images["depth"]).all()))
        ...     print(sorted(path.name for path in Path(folder).iterdir())[:3])
        True
        ['ball-alpha.png', 'ball-depth.png', 'ball-instance_id.png']
        """
        target = check_images_path(path)
        suffix = target.suffix.lower()
        if depth_scale is not None and suffix not in FILES_SUFFIXES:
            raise ConfigError(f"depth_scale is for PNG and PPM files: {suffix} files hold the distances themselves")
        if suffix == ".npz":
            arrays: dict[str, Any] = {**self._arrays, **self._describe()}
            write_atomically(target, lambda file: np.savez(file, **arrays))
        elif suffix == ".exr":
            list_exr_channels(self._arrays)
            write_images_exr(target, self._arrays, self._describe())
        else:
            check_file_targets(target, self._arrays)
            write_image_files(target, self._arrays, self._describe(), depth_scale)

    def _describe(self) -> dict[str, NDArray[Any]]:
        """Return the camera and the names as arrays."""
        described: dict[str, NDArray[Any]] = {"camera_to_world": self.camera_to_world}
        if (matrix := self.intrinsics) is not None:
            described["intrinsics"] = matrix
        described["size"] = np.array([self.width, self.height])
        described["geometry_names"] = np.array(self.geometry_names, np.str_)
        described["instance_names"] = np.array(self.instance_names, np.str_)
        return described


# Hits in float64, and vectors on the way to them.
_PIXEL_BYTES = 100


def make_images(
    scene: Scene,
    render: Callable[..., Picture],
    view: View,
    channels: Iterable[str],
    next_camera: Camera | None,
    next_transforms: Mapping[Any, ArrayLike] | None,
    on_phase: Callable[[str], None] | None,
) -> Images:
    """Return the images of `Renderer.images`, of a picture that `render` makes of a view."""
    names = check_channels(channels)
    next_pose = NextPose(scene, next_camera, next_transforms)
    if "motion" in names:
        next_pose.check()
    keeps_film = "colour" in names or "alpha" in names
    if not any(CHANNELS[name].needs_shading for name in names):
        # One ray for each pixel, and none to the light.
        view = view.changed(shading="normal", samples=None)
    picture = render(view, keeps_film=keeps_film, on_phase=on_phase)
    pixel_bytes = _PIXEL_BYTES + sum(CHANNELS[name].pixel_bytes for name in names)
    check_memory("the images", picture.found.size * pixel_bytes, SceneError)
    state = picture.world.state
    subject = Subject(picture, state.shapes, next_pose, view.smooth)
    arrays = {name: CHANNELS[name].find(subject) for name in names}
    return Images(arrays, picture.camera, geometry_names=state.names, instance_names=state.instance_names)
