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
    from .errors import (
        AppearanceWarning,
        ClbvhError,
        ClbvhWarning,
        ConfigError,
        DeviceError,
        DeviceMemoryError,
        FetchError,
        InternalError,
        KernelBuildError,
        MeshError,
        OpenMeshWarning,
        PoolError,
        QueryError,
        SceneError,
        TreeFileError,
        ValidationError,
    )
    from .geometry import Mesh, MeshLike, Spheres, load_mesh, make_shape
    from .geometry.appearance.appearance import Appearance
    from .geometry.appearance.material import Material
    from .geometry.appearance.smooth_normals import smooth_normals_by_angle
    from .geometry.appearance.texture import Texture
    from .geometry.shape import Shape
    from .rendering.as_scene import SceneLike
    from .rendering.camera import Camera
    from .rendering.contact_sheet import ContactSheet, contact_sheet
    from .rendering.cut import Cut
    from .rendering.film.environment_map import EnvironmentMap
    from .rendering.images.images import Images
    from .rendering.images.make_images import render_images
    from .rendering.lens import Lens
    from .rendering.light import Light
    from .rendering.mesh_source import MeshSource
    from .rendering.picture import Picture
    from .rendering.projection import Fisheye, Orthographic, Panorama
    from .rendering.render import render
    from .rendering.render_options import RenderOptions
    from .rendering.renderer import Renderer
    from .rendering.scene import Scene
    from .rendering.scene_file import open_scene
    from .rendering.transform import Transform
    from .rendering.turntable import render_turntable
    from .rendering.vectors import Vector
    from .rendering.wireframe import Wireframe
    from .scene.geometry import Geometry
    from .scene.instance import Instance
    from .scene.state import SceneState
    from .stats import TreeStats, measure_tree
    from .support.version import __version__ as __version__
    from .trace import AllHits, ClosestPoints, Hits, Normals, Progress, Traceable, Tracer
    from .trace.ambient_occlusion import ambient_occlusion

# The module of each name, in the order of the pipeline; the errors last.
_HOME_OF = {
    "__version__": "support.version",
    "Mesh": "geometry",
    "MeshLike": "geometry",
    "Spheres": "geometry",
    "Shape": "geometry.shape",
    "Appearance": "geometry.appearance.appearance",
    "Material": "geometry.appearance.material",
    "Texture": "geometry.appearance.texture",
    "smooth_normals_by_angle": "geometry.appearance.smooth_normals",
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
    "Normals": "trace",
    "Progress": "trace",
    "Traceable": "trace",
    "Tracer": "trace",
    "ambient_occlusion": "trace.ambient_occlusion",
    "Camera": "rendering.camera",
    "Cut": "rendering.cut",
    "Images": "rendering.images.images",
    "Lens": "rendering.lens",
    "Orthographic": "rendering.projection",
    "EnvironmentMap": "rendering.film.environment_map",
    "Fisheye": "rendering.projection",
    "Panorama": "rendering.projection",
    "Light": "rendering.light",
    "MeshSource": "rendering.mesh_source",
    "Picture": "rendering.picture",
    "RenderOptions": "rendering.render_options",
    "Renderer": "rendering.renderer",
    "Scene": "rendering.scene",
    "Geometry": "scene.geometry",
    "Instance": "scene.instance",
    "SceneState": "scene.state",
    "SceneLike": "rendering.as_scene",
    "Transform": "rendering.transform",
    "Vector": "rendering.vectors",
    "Wireframe": "rendering.wireframe",
    "open_scene": "rendering.scene_file",
    "render": "rendering.render",
    "render_images": "rendering.images.make_images",
    "render_turntable": "rendering.turntable",
    "ContactSheet": "rendering.contact_sheet",
    "contact_sheet": "rendering.contact_sheet",
    "ClbvhError": "errors",
    "MeshError": "errors",
    "SceneError": "errors",
    "TreeFileError": "errors",
    "ConfigError": "errors",
    "QueryError": "errors",
    "DeviceError": "errors",
    "DeviceMemoryError": "errors",
    "KernelBuildError": "errors",
    "FetchError": "errors",
    "PoolError": "errors",
    "ValidationError": "errors",
    "ClbvhWarning": "errors",
    "AppearanceWarning": "errors",
    "OpenMeshWarning": "errors",
    "InternalError": "errors",
}

__all__ = [  # noqa: RUF022 - in the order of the pipeline
    "Mesh",
    "MeshLike",
    "Spheres",
    "Shape",
    "Appearance",
    "Material",
    "Texture",
    "smooth_normals_by_angle",
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
    "Normals",
    "Progress",
    "Traceable",
    "Tracer",
    "ambient_occlusion",
    "Camera",
    "Cut",
    "Images",
    "Lens",
    "Orthographic",
    "EnvironmentMap",
    "Fisheye",
    "Panorama",
    "Light",
    "MeshSource",
    "Picture",
    "RenderOptions",
    "Renderer",
    "Scene",
    "Geometry",
    "Instance",
    "SceneState",
    "SceneLike",
    "Transform",
    "Vector",
    "Wireframe",
    "open_scene",
    "render",
    "render_images",
    "render_turntable",
    "ContactSheet",
    "contact_sheet",
    "ClbvhError",
    "MeshError",
    "SceneError",
    "TreeFileError",
    "ConfigError",
    "QueryError",
    "DeviceError",
    "DeviceMemoryError",
    "KernelBuildError",
    "FetchError",
    "PoolError",
    "ValidationError",
    "ClbvhWarning",
    "AppearanceWarning",
    "OpenMeshWarning",
    "InternalError",
]


__getattr__ = import_on_use(__name__, _HOME_OF)


def __dir__() -> list[str]:
    return sorted(__all__)
