"""clbvh: a parallel BVH build on the host, exact ray casting with OpenCL on any device.

The names below are the public interface. They are imported when first used, so that `import clbvh` costs
nothing and a build needs no OpenCL driver.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .support.lazy_imports import import_on_use

if TYPE_CHECKING:
    from .builders.build import build
    from .builders.options import BuildOptions
    from .builders.subtree_pool import SubtreePool
    from .bvh import Bvh, sah_cost, validate_tree
    from .device import choose_device, list_devices
    from .device.info import DeviceInfo
    from .geometry import Mesh, load_mesh, make_shape
    from .rendering.picture import Picture
    from .rendering.render import RenderOptions, render
    from .rendering.scene import Scene
    from .rendering.scene_file import open_scene
    from .stats import TreeStats, measure_tree
    from .trace import AllHits, ClosestPoints, Hits, Tracer

_HOME_OF = {
    "Mesh": "geometry",
    "load_mesh": "geometry",
    "make_shape": "geometry",
    "Bvh": "bvh",
    "TreeStats": "stats",
    "measure_tree": "stats",
    "sah_cost": "bvh",
    "validate_tree": "bvh",
    "BuildOptions": "builders.options",
    "SubtreePool": "builders.subtree_pool",
    "build": "builders.build",
    "DeviceInfo": "device.info",
    "choose_device": "device",
    "list_devices": "device",
    "AllHits": "trace",
    "ClosestPoints": "trace",
    "Hits": "trace",
    "Tracer": "trace",
    "Picture": "rendering.picture",
    "RenderOptions": "rendering.render",
    "Scene": "rendering.scene",
    "open_scene": "rendering.scene_file",
    "render": "rendering.render",
}

__all__ = [  # noqa: RUF022 - in the order of the pipeline
    "Mesh",
    "load_mesh",
    "make_shape",
    "Bvh",
    "TreeStats",
    "measure_tree",
    "sah_cost",
    "validate_tree",
    "BuildOptions",
    "SubtreePool",
    "build",
    "DeviceInfo",
    "choose_device",
    "list_devices",
    "AllHits",
    "ClosestPoints",
    "Hits",
    "Tracer",
    "Picture",
    "RenderOptions",
    "Scene",
    "open_scene",
    "render",
]


__getattr__ = import_on_use(__name__, _HOME_OF)


def __dir__() -> list[str]:
    return sorted(__all__)
