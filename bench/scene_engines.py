"""Each engine with the scenes of `test_scenes.py`: functions that a process of its own calls, see `Rival`.

A task that ends with rays returns the number of hits, by which one sees that engines do the same.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clbvh.study.engines import Queries

Array = NDArray[Any]


def place(vertices: Array, matrix: Array) -> Array:
    """Return vertices that are moved by a (4, 4) matrix."""
    return vertices @ matrix[:3, :3].T + matrix[:3, 3]


def ours(meshes: list[tuple[Array, Array]], of: list[int], frames: Array, rays: tuple[Array, Array]) -> Queries:
    """clbvh: instance i is a copy of the mesh ``of[i]``, in frame f at ``frames[f, i]``."""
    import clbvh

    scene = clbvh.Scene()
    geometries = [scene.add(mesh) for mesh in meshes]
    for mesh, matrix in zip(of, frames[0], strict=True):
        scene.place(geometries[mesh], matrix)
    tracer, turns = clbvh.Tracer(scene), itertools.count()

    def move() -> None:
        tracer.set_transforms(scene.instances, frames[next(turns) % len(frames)])

    def cast() -> int:
        return tracer.closest_hit(*rays).count

    def run() -> int:
        return sum((tracer.set_transforms(scene.instances, matrices), cast())[1] for matrices in frames)

    def one_frame() -> int:
        move()
        return cast()

    return {"move": move, "cast": cast, "frames": run, "frame": one_frame, "bytes": lambda: tracer.memory_bytes}


def open3d_flattened(
    meshes: list[tuple[Array, Array]], of: list[int], frames: Array, rays: tuple[Array, Array]
) -> Queries:
    """Open3D, which has no instances: every frame is flattened, built and cast."""
    import open3d

    tensor = open3d.core.Tensor
    packed = tensor(np.concatenate(rays, axis=1).astype(np.float32))
    faces = [tensor(np.asarray(mesh[1], np.uint32)) for mesh in meshes]
    turns = itertools.count()

    def build(matrices: Array) -> Any:
        scene = open3d.t.geometry.RaycastingScene()
        for mesh, matrix in zip(of, matrices, strict=True):
            scene.add_triangles(tensor(place(meshes[mesh][0], matrix).astype(np.float32)), faces[mesh])
        return scene

    kept: list[Any] = []

    def cast() -> int:
        if not kept:
            kept.append(build(frames[0]))
        return int(np.isfinite(kept[0].cast_rays(packed)["t_hit"].numpy()).sum())

    def one_frame() -> int:
        found = build(frames[next(turns) % len(frames)]).cast_rays(packed)
        return int(np.isfinite(found["t_hit"].numpy()).sum())

    return {"cast": cast, "frame": one_frame}


def trimesh_loop(meshes: list[tuple[Array, Array]], of: list[int], frames: Array, rays: tuple[Array, Array]) -> Queries:
    """Use trimesh over embreex: rays go into each mesh by its inverse transform, and the nearest hit is kept."""
    import trimesh
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    engines = [RayMeshIntersector(trimesh.Trimesh(*mesh, process=False)) for mesh in meshes]
    origins, directions = (np.asarray(array, np.float64) for array in rays)
    squares = (directions**2).sum(axis=1)
    turns = itertools.count()

    def one_frame() -> int:
        nearest = np.full(len(origins), np.inf)
        for mesh, matrix in zip(of, frames[next(turns) % len(frames)], strict=True):
            inverse = np.linalg.inv(matrix)
            locations, index_ray, _ = engines[mesh].intersects_location(
                place(origins, inverse), directions @ inverse[:3, :3].T, multiple_hits=False
            )
            t = ((place(locations, matrix) - origins[index_ray]) * directions[index_ray]).sum(axis=1)
            nearest[index_ray] = np.minimum(nearest[index_ray], t / squares[index_ray])
        return int(np.isfinite(nearest).sum())

    return {"frame": one_frame}
