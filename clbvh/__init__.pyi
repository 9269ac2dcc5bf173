"""The public names of clbvh, and the module of each. `__init__.py` reads them from here, and type checkers do."""

from .builders.build import build as build
from .builders.options import BuildOptions as BuildOptions
from .builders.processes.pool import SubtreePool as SubtreePool
from .bvh import Bvh as Bvh, sah_cost as sah_cost, validate_tree as validate_tree
from .device.info import DeviceInfo as DeviceInfo
from .device.select import choose_device as choose_device, list_devices as list_devices
from .errors import (
    AppearanceWarning as AppearanceWarning,
    ClbvhError as ClbvhError,
    ClbvhWarning as ClbvhWarning,
    ConfigError as ConfigError,
    DeviceError as DeviceError,
    DeviceMemoryError as DeviceMemoryError,
    FetchError as FetchError,
    InternalError as InternalError,
    KernelBuildError as KernelBuildError,
    MeshError as MeshError,
    OpenMeshWarning as OpenMeshWarning,
    PoolError as PoolError,
    QueryError as QueryError,
    SceneError as SceneError,
    TreeFileError as TreeFileError,
    ValidationError as ValidationError,
)
from .files.open_scene import SceneLike as SceneLike, open_scene as open_scene
from .files.scene_file import save_scene as save_scene
from .geometry import (
    Mesh as Mesh,
    MeshLike as MeshLike,
    Part as Part,
    Spheres as Spheres,
    load_mesh as load_mesh,
    make_shape as make_shape,
)
from .geometry.appearance.appearance import Appearance as Appearance
from .geometry.appearance.material import Material as Material, Texture as Texture
from .geometry.shards import Shard as Shard, shard_mesh as shard_mesh
from .geometry.smooth_normals import smooth_normals_by_angle as smooth_normals_by_angle
from .geometry.spheres import Shape as Shape
from .rendering.images import Images as Images
from .rendering.options import RenderOptions as RenderOptions
from .rendering.picture import Picture as Picture
from .rendering.renderer import Renderer as Renderer, render as render, render_images as render_images
from .rendering.scene_ref import SceneRef as SceneRef
from .rendering.series import (
    ContactSheet as ContactSheet,
    contact_sheet as contact_sheet,
    render_turntable as render_turntable,
)
from .scene.handles import Geometry as Geometry, Instance as Instance, Instances as Instances
from .scene.scene import Scene as Scene
from .scene.state import SceneState as SceneState
from .scene.transforms import Transform as Transform
from .stats import TreeStats as TreeStats, measure_tree as measure_tree
from .support.settings import Vector as Vector
from .support.version import __version__ as __version__
from .trace.hits.device_hits import DeviceHits as DeviceHits
from .trace.hits.hits import AllHits as AllHits, Hits as Hits
from .trace.hits.normals import Normals as Normals
from .trace.pair_queries import ClosestPair as ClosestPair
from .trace.points.refine import AllClosestPoints as AllClosestPoints, ClosestPoints as ClosestPoints
from .trace.rays.pieces import Progress as Progress
from .trace.shards import ShardedTracer as ShardedTracer
from .trace.tracer import Traceable as Traceable, Tracer as Tracer
from .viewer.open import view as view
from .views.cameras.camera import Camera as Camera
from .views.cameras.lens import Lens as Lens
from .views.cameras.projection import Fisheye as Fisheye, Orthographic as Orthographic, Panorama as Panorama
from .views.cut import Cut as Cut
from .views.environment_map import EnvironmentMap as EnvironmentMap
from .views.view import Light as Light, Section as Section, View as View, Wireframe as Wireframe
