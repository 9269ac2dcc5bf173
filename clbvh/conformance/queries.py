"""Asks a device about a case in one layout: answers are named arrays with one row per ray, point or pixel."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..device.session import DeviceSession
from ..rendering.band_painters import OneRayPainter
from ..rendering.camera import Camera
from ..rendering.frame import FrameRenderer
from ..rendering.picture import refine_pixels
from ..rendering.scene import MeshSource, Scene
from ..rendering.view import make_view
from ..structs import LAYOUT_WIDTHS, REPORT_SHADINGS
from ..trace.device_tree import BRUTE, DeviceTree
from ..trace.hits.hits import AllHits, Hits
from ..trace.launch import device_casts_all
from ..trace.tracer import Tracer
from .cases import Case

# An answer: parts by name, each (n, ...).
Answer = dict[str, NDArray]

# Every layout answers; the one without a tree only in pictures.
ALL_LAYOUTS = (*LAYOUT_WIDTHS, BRUTE)

# Crossings of a ray of which all are compared; of the others only the number.
_COMPARED_HITS = 12

# Pixels of a picture: more than one tile each way, and no multiple of it.
_PICTURE_WIDTH, _PICTURE_HEIGHT = 22, 13

# The camera looks along an axis, at a point beside the middle, so that its axes are exact: in sizes of the mesh.
_EYE_ASIDE, _EYE_AWAY = (0.125, 0.0625), 2.25


def answer_rays(case: Case, bvh: Bvh, layout: str, device: DeviceInfo) -> Iterator[tuple[str, Answer]]:
    """Yield each query about rays and points, and its answer."""
    origins, directions, t_min, t_max = case.rays
    with Tracer(bvh, device=device, layout=layout) as tracer:
        queries: dict[str, Callable[[], Answer]] = {
            "closest_hit": lambda: _describe_hits(tracer.closest_hit(origins, directions, t_min=t_min, t_max=t_max)),
            "any_hit": lambda: {"is_hit": tracer.any_hit(origins, directions, t_min=t_min, t_max=t_max)},
            "count_hits": lambda: {"count": tracer.count_hits(origins, directions, t_min=t_min, t_max=t_max)},
            "all_hits": lambda: _describe_all_hits(tracer.all_hits(origins, directions, t_min=t_min, t_max=t_max)),
            "closest_point": lambda: dict(tracer.closest_point(case.points)._asdict()),
        }
        if case.is_closed:
            queries["contains"] = lambda: {"is_inside": tracer.contains(case.points)}
        for name, ask in queries.items():
            with device_casts_all():
                answer = ask()
            yield name, answer


def answer_pictures(case: Case, bvh: Bvh, layout: str, device: DeviceInfo) -> Iterator[tuple[str, Answer]]:
    """Yield each shading, and the picture in it."""
    mesh, extent = case.mesh, np.ptp(case.vertices, axis=0)
    size = extent.max()
    aside = case.vertices.min(axis=0) + extent / 2 + size * np.array([*_EYE_ASIDE, 0.0])
    eye = aside + size * np.array([0.0, 0.0, _EYE_AWAY])
    camera = Camera(tuple(eye), tuple(aside))
    scene = Scene(MeshSource(shape="knot"), width=_PICTURE_WIDTH, height=_PICTURE_HEIGHT)
    with DeviceSession(device) as session:
        tree = DeviceTree(session, mesh, None if layout == BRUTE else bvh, "auto" if layout == BRUTE else layout)
        renderer, painter = FrameRenderer(session, tree), OneRayPainter(session, tree)
        for shading in REPORT_SHADINGS:
            view = make_view(scene.with_changes(shading=shading), camera, mesh)
            colours, found = renderer.render(view, painter)
            hits = refine_pixels(mesh, camera, found)
            yield f"picture {shading}", _describe_hits(hits) | {"colour": colours.reshape(found.size, -1)}


def _describe_hits(hits: Hits) -> Answer:
    return {
        "prim_id": hits.prim_id.reshape(-1),
        "tuv": np.stack((hits.t.reshape(-1), hits.u.reshape(-1), hits.v.reshape(-1)), axis=1),
    }


def _describe_all_hits(hits: AllHits) -> Answer:
    """Return the first crossings of each ray; where it has fewer, prim_id is -1 and the rest 0."""
    ray_count = len(hits.offsets) - 1
    prim_id = np.full((ray_count, _COMPARED_HITS), -1, np.int32)
    tuv = np.zeros((ray_count, _COMPARED_HITS, 3))
    depth = np.arange(len(hits)) - np.repeat(hits.offsets[:-1], hits.counts)
    is_compared = depth < _COMPARED_HITS
    at = hits.ray_id[is_compared], depth[is_compared]
    prim_id[at] = hits.prim_id[is_compared]
    tuv[at] = np.stack((hits.t, hits.u, hits.v), axis=1)[is_compared]
    return {"count": hits.counts, "prim_id": prim_id, "tuv": tuv}
