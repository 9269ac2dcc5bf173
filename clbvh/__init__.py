"""clbvh: a parallel BVH build on the host, exact ray casting with OpenCL on any device.

The names below are the public interface. They are imported when first used, so that `import clbvh` costs
nothing and a build needs no OpenCL driver.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .lazy import import_on_use

if TYPE_CHECKING:
    from .build import BuildOptions, SubtreePool, build
    from .device import DeviceInfo, choose_device, list_devices
    from .geometry import Mesh, load_mesh, make_shape
    from .render import Picture, RenderOptions, Scene, open_scene, render
    from .trace import AllHits, ClosestPoints, Hits, Tracer
    from .tree import Bvh, TreeStats, measure_tree, sah_cost, validate_tree

_HOME_OF = {
    "Mesh": "geometry",
    "load_mesh": "geometry",
    "make_shape": "geometry",
    "Bvh": "tree",
    "TreeStats": "tree",
    "measure_tree": "tree",
    "sah_cost": "tree",
    "validate_tree": "tree",
    "BuildOptions": "build",
    "SubtreePool": "build",
    "build": "build",
    "DeviceInfo": "device",
    "choose_device": "device",
    "list_devices": "device",
    "AllHits": "trace",
    "ClosestPoints": "trace",
    "Hits": "trace",
    "Tracer": "trace",
    "Picture": "render",
    "RenderOptions": "render",
    "Scene": "render",
    "open_scene": "render",
    "render": "render",
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
