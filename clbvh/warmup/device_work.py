"""Work on a device that needs every kernel, and every host function of queries, pictures and the engine for trimesh."""

from __future__ import annotations

import itertools

import numpy as np
import trimesh
from numpy.typing import DTypeLike, NDArray

from ..builders.registry import DEFAULT_BUILDER
from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..geometry import Spheres
from ..integrations.trimesh import ProximityQuery, RayMeshIntersector, max_tangent_sphere, thickness
from ..rendering.render import RenderOptions, render
from ..rendering.scene import MeshSource, Scene
from ..structs import REPORT_SHADINGS
from ..trace.scene.merging import LEAST_COUNT
from ..trace.tracer import Tracer
from .host_work import TRIANGLES, make_mesh

# Beyond this a driver may compile a kernel once more, and batches in no order are sorted.
_MANY = 70_000

# Of a square picture with more rays than that.
_SIDE = 270

_PICTURE = (24, 32)

# More rays than the host casts itself.
_SOME = 2_000
_SEED = 7


def cast_all(bvh: Bvh, device: DeviceInfo, layout: str, dtype: DTypeLike) -> None:
    """Run every query with arrays of one dtype: few rays, a picture's rays, many unordered rays, and points."""
    random = np.random.default_rng(_SEED)
    centre, size = bvh.mesh.origin, np.ptp(bvh.mesh.vertices, axis=0).max()

    def make(*shape: int) -> NDArray[np.floating]:
        return (centre + size * (random.random((*shape, 3)) - 0.5)).astype(dtype)

    with Tracer(bvh, device=device, layout=layout) as tracer:
        for shape in ((3,), _PICTURE, (_SOME,), (_MANY,)):
            origins, directions = make(*shape), make(*shape)
            hits = tracer.closest_hit(origins, directions)
            hits.locations, hits.normals(smooth=True)  # computed when they are asked for
            seen = hits[hits.is_hit]
            seen.offset_origins()
            seen.offset_origins(towards=seen.normals)
            tracer.closest_prim(origins, directions)
            tracer.any_hit(origins, directions)
            tracer.count_hits(origins, directions)
            crossings = tracer.all_hits(origins, directions, max_hits=4)
            crossings.locations, crossings.counts  # noqa: B018
            tracer.all_hits(origins, directions, with_locations=True)
            points = make(*shape)
            tracer.closest_point(points)
            tracer.contains(points)
            tracer.signed_distance(points)
            tracer.ambient_occlusion(points, directions, rays=1)
        # Many rays in order are searched for the rows of a picture.
        towards = np.stack(np.meshgrid(1.0, *[np.linspace(-0.5, 0.5, _SIDE)] * 2, indexing="ij"), axis=-1)
        rows = towards.reshape(-1, 3).astype(dtype)
        for query in (tracer.closest_hit, tracer.any_hit, tracer.count_hits, tracer.all_hits):
            query(make(), rows, t_min=np.zeros(len(rows)), t_max=np.full(len(rows), size))
        # In any order they are sorted in another way than rays of several origins.
        tracer.closest_hit(make(), random.permutation(rows))
        tracer.update(bvh.mesh.vertices)
        tracer.closest_hit(make(), make())


def use_scene(device: DeviceInfo, layout: str, *, has_spheres: bool) -> None:
    """Run the queries of scenes of meshes, or of meshes and spheres, and draw one."""
    random = np.random.default_rng(_SEED)
    mesh = make_mesh()
    contents = Scene(width=_PICTURE[1], height=_PICTURE[0])
    knot = contents.add(mesh)
    instances = [contents.place(knot), contents.place(knot)]
    # Meshes that are merged, one of which leaves the others below.
    single = [contents.place(contents.add(mesh)) for _ in range(LEAST_COUNT)]
    if has_spheres:
        contents.place(contents.add(Spheres(random.normal(size=(20, 3)), 0.2)))
    for shading in (*REPORT_SHADINGS, "studio"):
        options = RenderOptions(device=device, layout=layout)
        render(contents, options, shading=shading).hits  # noqa: B018 - computed when they are asked for
    with Tracer(contents, device=device, layout=layout) as tracer:
        for dtype, shape in itertools.product((np.float32, np.float64), ((3,), _PICTURE, (_MANY,))):
            count = shape[:-1] if shape == (3,) else shape
            origins, directions = (random.normal(size=(*count, 3)).astype(dtype) for _ in range(2))
            hits = tracer.closest_hit(origins, directions, mask=np.ones(count, np.uint32))
            hits.locations, hits.normals(smooth=True, facing=True)
            hits.interpolate({knot: mesh.vertices})
            seen = hits[hits.is_hit]
            seen.offset_origins()
            seen.offset_origins(towards=seen.normals)
            tracer.closest_prim(origins, directions)
            tracer.any_hit(origins, directions)
            tracer.count_hits(origins, directions)
            tracer.all_hits(origins, directions, with_locations=True)
            tracer.all_hits(origins, directions, with_locations=True)
            tracer.closest_point(origins)
            tracer.closest_point(origins, instance=instances[0])
            tracer.contains(origins)
            tracer.signed_distance(origins)
            tracer.ambient_occlusion(origins, directions, rays=1)
        for moved in (instances[0], single[0]):
            tracer.set_transforms(moved, np.diag([1.0, 2.0, 1.0, 1.0]))
        tracer.set_vertices(knot, mesh.vertices)
    if has_spheres:
        _use_lone_spheres(device, layout)


def _use_lone_spheres(device: DeviceInfo, layout: str) -> None:
    """Run the queries of rays at spheres that are alone in their scene, and move them."""
    random = np.random.default_rng(_SEED)
    centres = random.normal(size=(20, 3))
    contents = Scene()
    spheres = contents.add(Spheres(centres, 0.2))
    contents.place(spheres)
    with Tracer(contents, device=device, layout=layout) as tracer:
        for count in (3, _MANY):
            origins, directions = (random.normal(size=(count, 3)) for _ in range(2))
            for query in (tracer.closest_hit, tracer.any_hit, tracer.count_hits, tracer.all_hits):
                query(origins, directions)
        towards = np.stack(np.meshgrid(1.0, *[np.linspace(-0.5, 0.5, _SIDE)] * 2, indexing="ij"), axis=-1)
        tracer.closest_hit(np.zeros(3), towards[0])
        tracer.set_spheres(spheres, centres * 1.1)


def use_trimesh(device: DeviceInfo) -> None:
    """Run the queries of the engine for trimesh: rays, and proximity with all that it depends on."""
    mesh = make_mesh()
    other = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    rays = RayMeshIntersector(other, device=device)
    origins, directions = np.zeros((3, 3)), np.eye(3)
    rays.intersects_location(origins, directions)
    rays.intersects_first(origins, directions)
    proximity = ProximityQuery(other, device=device)
    proximity.signed_distance(origins)
    proximity.vertex(origins)
    other.vertices += 1.0
    proximity.vertex(origins)
    rays.intersects_location(origins, directions)
    max_tangent_sphere(other, other.triangles_center[:3])
    thickness(other, other.triangles_center[:3])


def draw(device: DeviceInfo, layout: str, *, validate: bool = False, builder: str = DEFAULT_BUILDER) -> None:
    """Render small pictures, and find their hits in float64."""
    scene = Scene(MeshSource(shape="knot", triangles=TRIANGLES), width=_PICTURE[1], height=_PICTURE[0])
    options = RenderOptions(builder=builder, device=device, layout=layout, validate=validate)
    for shading in ("studio", "lambert"):
        render(scene, options, shading=shading).hits  # noqa: B018 - computed when they are asked for
