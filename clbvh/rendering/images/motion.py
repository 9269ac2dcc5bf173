"""How far what a pixel sees moves in the picture, from one pose of the camera and the scene to another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ConfigError, SceneError
from ...scene.transforms import check_transform
from ...trace.hits.surface import SceneSurface, SurfacePoints
from ..camera import Camera
from ..picture import Picture
from ..scene import Scene
from ..scene_objects import SceneObjects

# Pixels whose points are in memory at a time.
_CHUNK_PIXELS = 1 << 20


class NextPose:
    """The second pose of a camera and of instances, checked.

    Parameters
    ----------
    scene : Scene
        Of the first pose.
    camera : Camera or None
        None: that of the picture.
    transforms : mapping of instances, ids or names to (4, 4) float, or None
        From the coordinates of each instance's geometry to the scene's. The others stay where they are.

    Raises
    ------
    SceneError
        No camera, an instance that the scene does not have, or a matrix that is not finite, not affine or singular.
    """

    def __init__(
        self, scene: Scene, camera: Camera | None = None, transforms: Mapping[Any, ArrayLike] | None = None
    ) -> None:
        if camera is not None and not isinstance(camera, Camera):
            raise SceneError(f"the next camera must be a clbvh.Camera, not {camera!r}")
        if transforms is not None and not isinstance(transforms, Mapping):
            raise SceneError(f"the next transforms must be a mapping, {{instance: matrix, ...}}, not {transforms!r}")
        self._scene, self._camera = scene, camera
        keys = [scene.find(key) if isinstance(key, str) else key for key in transforms or {}]
        self._ids = scene.instance_ids(keys) if keys else np.empty(0, np.int64)
        self._matrices = np.stack(
            [
                check_transform(matrix, f"the next transform of {key!r}")
                for key, matrix in zip(keys, (transforms or {}).values(), strict=True)
            ]
            or [np.eye(4)]
        )[: len(keys)]

    def check(self) -> None:
        """Raise `ConfigError` unless there is anything that can differ from the first pose."""
        if self._camera is None and not len(self._ids):
            raise ConfigError("the channel motion needs a second pose: give next_camera or next_transforms")

    def find_motion(self, picture: Picture) -> NDArray[np.float32]:
        """Return (height, width, 2) float32: pixels to the right and downwards, NaN on a miss; see `Images`."""
        self.check()
        height, width = picture.found.shape
        camera = self._camera or picture.camera
        hits = picture.hits
        motion = np.full((height * width, 2), np.nan, np.float32)
        locate = self._make_locator(picture)
        seen = np.flatnonzero(hits.is_hit)
        for begin in range(0, len(seen), _CHUNK_PIXELS):
            pixels = seen[begin : begin + _CHUNK_PIXELS]
            centres = np.stack((pixels % width + 0.5, pixels // width + 0.5), axis=-1)
            of_pixels = hits.take(pixels)
            points = SurfacePoints(of_pixels.prim_id, of_pixels.instance_id, of_pixels.u, of_pixels.v)
            motion[pixels] = camera.project(locate(points, of_pixels.locations), width, height)[0] - centres
        return motion.reshape(height, width, 2)

    def _make_locator(self, picture: Picture) -> Any:
        """Return the function from points on surfaces, and their locations, to the locations in the second pose."""
        if not len(self._ids):
            return lambda points, locations: locations
        objects = picture.objects
        if isinstance(objects, SceneObjects):
            if (newest := int(self._ids.max())) >= objects.instance_count:
                raise SceneError(f"instance {newest} was placed after the renderer was opened: open another one")
            state = objects.state.with_transforms(self._ids, self._matrices)
            surface = SceneSurface.from_shapes(state.shapes, state.names, state.geometry_ids, state.transforms)
            return lambda points, locations: surface.locate(points)
        # One mesh, whose coordinates have the scene's transform in them.
        first = self._scene.transform.matrix if self._scene.is_one_mesh else np.eye(4)
        change = self._matrices[-1] @ np.linalg.inv(first)
        return lambda points, locations: locations @ change[:3, :3].T + change[:3, 3]
