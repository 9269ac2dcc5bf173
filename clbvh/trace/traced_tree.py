"""What queries need of a tree on a device, whether it is that of a mesh or of a scene."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np


class TracedTree(Protocol):
    """A `DeviceTree`, a `DeviceScene` or a `LoneSpheres`."""

    @property
    def layout(self) -> str:
        """Name of the layout."""

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of every traversal kernel by name."""

    @property
    def defines(self) -> dict[str, int]:
        """Macros of every traversal kernel."""

    @property
    def has_entry_points(self) -> bool:
        """Whether rays may begin elsewhere than at the root, see cl/traversal/entry_point.cl."""

    @property
    def has_instances(self) -> bool:
        """Whether the kernels are those of scenes."""

    @property
    def ray_tree(self) -> Any:
        """The tree for rays alone, a `LoneSpheres`; None: this one."""

    @property
    def ray_dtype(self) -> np.dtype:
        """Of packed rays."""

    @property
    def point_dtype(self) -> np.dtype:
        """Of packed points."""

    @property
    def hit_dtype(self) -> np.dtype:
        """Of hits on the device: `structs.HIT`, or `structs.SCENE_HIT` with ids of instances."""

    @property
    def advances_rays(self) -> bool:
        """Whether the device advances rays to instances; False of a mesh."""

    @property
    def node_bytes(self) -> int:
        """Size of a node."""

    @property
    def memory_bytes(self) -> int:
        """Bytes of all buffers."""

    @property
    def mesh(self) -> Any:
        """The mesh; None of a scene."""

    @property
    def scene_surface(self) -> Any:
        """What hits keep of the scene; None of a mesh."""

    @property
    def surface(self) -> Any:
        """What hits are refined on: `Triangles` or `SceneArrays`."""

    @property
    def most_crossings(self) -> int:
        """Most crossings that a ray can have."""

    def on_host(self) -> Any:
        """Return the tree as the host sees it, a `WideArrays`, for calls that are running; None where it does not."""
