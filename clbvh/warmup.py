"""Runs each kind of work once at small scale, so that a driver compiles before anybody waits for it.

There is no list of kernels: real calls compile what real calls need. The host's own are compiled in the package.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

import clbvh

from .choices import SHADINGS

Work = tuple[str, Callable[[], object]]

# Enough for a tree with several subtrees.
_TRIANGLES = 3_000

# Rays of one query: a few, and a batch that the device sorts.
_COUNTS = 3, 70_000

_WIDTH, _HEIGHT = 32, 24


def list_work(device: clbvh.DeviceInfo) -> Iterator[Work]:
    """Yield names and work for a device."""
    mesh = clbvh.make_shape("knot", triangles=_TRIANGLES)
    yield "build, quality fast", partial(clbvh.build, mesh, quality="fast", device=device)
    spheres = clbvh.Scene(clbvh.Spheres(mesh.vertices[::20], 0.05))
    scene = clbvh.Scene()
    for shape in (mesh, mesh, clbvh.Spheres([[0.0, 0.0, 2.0]], 0.5)):
        scene.place(scene.add(shape))
    for shading in SHADINGS:
        yield f"picture, {shading}", partial(_draw, mesh, device, shading)
    yield "picture of a scene", partial(_draw, scene, device, "studio")
    sources: dict[str, clbvh.Scene | clbvh.Mesh] = {"a mesh": mesh, "spheres": spheres, "a scene": scene}
    for what, source in sources.items():
        yield f"queries of {what}", partial(_cast, source, device)


def _draw(source: clbvh.Scene | clbvh.Mesh, device: clbvh.DeviceInfo, shading: str) -> None:
    """Draw a small picture, and find its hits in float64."""
    view = clbvh.View(width=_WIDTH, height=_HEIGHT, shading=shading, samples=1)
    clbvh.render(source, view, clbvh.RenderOptions(device=device)).hits  # noqa: B018


def _cast(source: clbvh.Scene | clbvh.Mesh, device: clbvh.DeviceInfo) -> None:
    """Ask everything about rays and points, of each kind of batch."""
    random = np.random.default_rng(7)
    with clbvh.Tracer(source, device=device) as tracer:
        for count in _COUNTS:
            origins, directions = random.normal(size=(2, count, 3))
            tracer.closest_hit(origins, directions)
            tracer.any_hit(origins, directions)
            tracer.count_hits(origins, directions)
            tracer.all_hits(origins, directions)
            tracer.closest_point(origins)
            tracer.closest_points(origins, 2)
            tracer.prims_in_boxes(origins, origins + 1)
            tracer.contains(origins)
            tracer.signed_distance(origins)
            tracer.ambient_occlusion(origins, directions, rays=1)
        if isinstance(source, clbvh.Mesh):
            tracer.update(source.vertices)
            # Torn to pieces: the device builds the tree anew.
            tracer.update(random.permutation(source.vertices))
            tracer.closest_hit(np.zeros(3), np.ones(3))
