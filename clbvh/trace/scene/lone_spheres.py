"""A scene that is nothing but spheres in their place, as rays see it: one tree without instances.

Rays are packed and cast as at a mesh, with the entry points of a mesh; hits have the ids of a scene. All other queries
use the scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...structs import ENTRY_POINT_LAYOUTS, PACKED_POINT, PACKED_RAY, SCENE_HIT
from ..rays.batch import TreeBox

if TYPE_CHECKING:
    from .device_scene import DeviceScene

# The boxes of spheres reach farther than the spheres by less than this, in local units of at most 1.
_MARGIN = 2.0**-17


class LoneSpheres:
    """In place of a `DeviceTree`, for rays alone.

    Parameters
    ----------
    scene : DeviceScene
        One group of spheres, whose arrays are the first ones in its buffers.
    block_count : int

    Attributes
    ----------
    box : TreeBox
        Around the spheres.
    layout, arguments, defines, has_entry_points, node_bytes, memory_bytes
        As in `DeviceTree`.
    scene_surface, surface, most_crossings
        As in `DeviceScene`.
    """

    has_instances = False
    advances_rays = False
    ray_dtype = PACKED_RAY
    point_dtype = PACKED_POINT
    hit_dtype = SCENE_HIT
    mesh = None
    ray_tree = None

    def __init__(self, scene: DeviceScene, block_count: int) -> None:
        # Its buffers are given back when nobody holds it.
        self._scene = scene
        self.layout, self.node_bytes, self.memory_bytes = scene.layout, scene.node_bytes, scene.memory_bytes
        self.surface, self.most_crossings = scene.surface, scene.most_crossings
        self.arguments: dict[str, Any] = {
            "nodes": scene.arguments["nodes"],
            "blocks": scene.arguments["spheres"],
            "block_count": np.int32(block_count),
        }
        self.defines = {name: scene.defines[name] for name in ("LAYOUT", "STACK_SIZE", "HAS_INSTANCES", "HAS_SPHERES")}
        self.defines["LONE_SPHERES"] = 1
        self.has_entry_points = self.layout in ENTRY_POINT_LAYOUTS
        spheres = scene.state.shapes[scene.state.geometry_ids[0]]
        half = np.abs(spheres.local_box).max(axis=0).astype(np.float64) + _MARGIN
        self.box = TreeBox(spheres.origin, spheres.scale, half)

    def on_host(self) -> None:
        """Return None: the host casts at meshes alone."""

    @property
    def scene_surface(self) -> Any:
        """What hits keep of the scene."""
        return self._scene.scene_surface
