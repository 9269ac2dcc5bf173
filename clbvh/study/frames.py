"""One picture of a finished tree, drawn on the measured device, with the device's own times."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..bvh import Bvh
from ..device.session import DeviceSession
from ..rendering.band_painters import OneRayPainter
from ..rendering.frame import FrameRenderer
from ..rendering.scene import MeshSource, Scene
from ..rendering.view import make_view
from ..trace.device_tree import DeviceTree
from .bench import Bench

_DIGEST_BYTES = 8


@dataclass(frozen=True)
class Frame:
    """A picture and its times.

    Attributes
    ----------
    rgb : (height, width, 3) uint8
    digest : str
        Equal for pictures that are equal bit by bit, hits included.
    times_ms : dict of str to float
        upload, kernel and download, by the device's clock.
    """

    rgb: NDArray[np.uint8]
    digest: str
    times_ms: dict[str, float]


def draw_frame(
    bench: Bench, mesh: str, bvh: Bvh, size: tuple[int, int], *, layout: str = "auto", shading: str = "lambert"
) -> Frame:
    """Upload a tree, draw one picture with it, and take everything off the device again.

    Parameters
    ----------
    bench : Bench
    mesh : str
        The name of the tree's mesh.
    bvh : Bvh
    size : (int, int)
        Width and height.
    layout, shading : str
    """
    width, height = size
    scene = Scene(mesh=MeshSource(shape="knot"), width=width, height=height, shading=shading)
    view = make_view(scene, bench.camera(mesh, width, height), bvh.mesh)
    with DeviceSession(bench.device) as session:
        tree = DeviceTree(session, bvh.mesh, bvh, layout)
        colours, hits = FrameRenderer(session, tree).render(view, OneRayPainter(session, tree))
        times_ms = session.times.sums_ms()
    rgb = np.ascontiguousarray(colours[..., :3])
    digest = hashlib.blake2b(rgb.tobytes(), digest_size=_DIGEST_BYTES)
    digest.update(hits.tobytes())
    return Frame(rgb, digest.hexdigest(), {name: float(ms) for name, ms in times_ms.items()})
