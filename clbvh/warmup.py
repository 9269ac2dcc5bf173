"""Runs each kind of work once at small scale, so that what it needs is compiled before somebody waits for it.

There is no list of functions: real calls compile them for the types of real calls.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import clbvh

from .choices import SHADINGS

Work = tuple[str, Callable[[], object]]

# Enough for a tree with several subtrees.
_TRIANGLES = 3_000

# Rays of one query: one, as many as one thread of the host casts and as several do, and a batch that the device sorts.
_COUNTS = ((), (3,), (2_000,), (70_000,))

_WIDTH, _HEIGHT = 32, 24


def list_work(device: clbvh.DeviceInfo) -> Iterator[Work]:
    """Yield names and work for a device."""
    mesh = clbvh.make_shape("knot", triangles=_TRIANGLES)
    yield "build, quality fast", partial(clbvh.build, mesh, quality="fast", device=device)
    for quality in ("default", "high"):
        yield f"build, quality {quality}", partial(clbvh.build, mesh, quality=quality)
    yield "files, refit and measures of a tree", partial(_use_tree, mesh)
    spheres = clbvh.Scene(clbvh.Spheres(mesh.vertices[::20], 0.05))
    scene = clbvh.Scene()
    # Many of each kind: the trees of small shapes are built together.
    small, ball = clbvh.make_shape("icosphere", triangles=20), clbvh.Spheres([[0.0, 0.0, 2.0]], 0.5)
    for geometry in (*map(scene.add, 2 * [mesh] + 16 * [small]), *map(scene.add, 16 * [ball])):
        scene.place(geometry)
    for shading in SHADINGS:
        yield f"picture, {shading}", partial(_draw, mesh, device, shading)
    yield "picture of a scene", partial(_draw, scene, device, "studio")
    sources: dict[str, clbvh.Scene | clbvh.Mesh] = {"a mesh": mesh, "spheres": spheres, "a scene": scene}
    for what, dtype in product(sources, ("f8", "f4")):
        yield f"queries of {what}, {np.dtype(dtype)}", partial(_cast, sources[what], device, dtype)


def _use_tree(mesh: clbvh.Mesh) -> None:
    """Keep a tree, load it for a mesh from a file, refit it, and measure it."""
    with TemporaryDirectory(prefix="clbvh-") as folder:
        text, kept = Path(folder, "mesh.ply"), Path(folder, "mesh.tree")
        lines = ["ply", "format ascii 1.0", f"element vertex {len(mesh.vertices)}"]
        lines += [f"property float {axis}" for axis in "xyz"]
        lines += [f"element face {mesh.face_count}", "property list uchar int vertex_indices", "end_header"]
        lines += [" ".join(map(str, vertex)) for vertex in mesh.vertices.tolist()]
        lines += ["3 " + " ".join(map(str, face)) for face in mesh.faces.tolist()]
        text.write_text("\n".join([*lines, ""]))
        loaded = clbvh.load_mesh(text)
        clbvh.build(loaded).save(kept)
        bvh = clbvh.Bvh.load(kept, loaded)
    bvh.refit(loaded.vertices)
    clbvh.validate_tree(bvh)
    clbvh.measure_tree(bvh)


def _draw(source: clbvh.Scene | clbvh.Mesh, device: clbvh.DeviceInfo, shading: str) -> None:
    """Draw a small picture, and find its hits in float64."""
    view = clbvh.View(width=_WIDTH, height=_HEIGHT, shading=shading, samples=1)
    clbvh.render(source, view, clbvh.RenderOptions(device=device)).hits  # noqa: B018


def _cast(source: clbvh.Scene | clbvh.Mesh, device: clbvh.DeviceInfo, dtype: str) -> None:
    """Ask everything about rays and points, of each kind of batch."""
    random = np.random.default_rng(7)
    with clbvh.Tracer(source, device=device) as tracer:
        for shape in _COUNTS:
            origins, directions = (random.normal(size=(*shape, 3)).astype(dtype) for _ in range(2))
            hits = tracer.closest_hit(origins, directions)
            hits.locations, hits.normals(smooth=True)
            hits[hits.is_hit].offset_origins()
            tracer.closest_prim(origins, directions)
            tracer.any_hit(origins, directions)
            tracer.count_hits(origins, directions)
            tracer.all_hits(origins, directions, with_locations=True)
            if dtype == "f4":  # few ask for points in float32
                continue
            tracer.closest_point(origins)
            tracer.closest_points(origins, 2)
            tracer.contains(origins)
            tracer.signed_distance(origins)
            tracer.ambient_occlusion(origins, directions, rays=1)
        if isinstance(source, clbvh.Scene) and len(source.geometries) > 1:
            tracer.closest_pair(0, 1)
            tracer.collisions([0, 1])
        # From one point, in any order and row by row.
        tracer.closest_hit(np.zeros(3, dtype), directions)
        tracer.closest_hit(np.zeros(3, dtype), np.sort(directions, axis=0))
        if isinstance(source, clbvh.Mesh):
            tracer.update(source.vertices)
            # Torn to pieces: the device builds the tree anew.
            tracer.update(random.permutation(source.vertices))
            tracer.closest_hit(np.zeros(3), np.ones(3))
