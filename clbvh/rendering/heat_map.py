"""The steps of rays through a tree: as a picture with a bar of colours, or as means over three kinds of rays.

The colours run from dark blue over green to light yellow, evenly in lightness, so that they keep their order in grey
and for colour-blind people.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..builders.build import build_shapes
from ..builders.options import DEFAULT_QUALITY
from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..device.open import open_device
from ..errors import ConfigError, MeshError
from ..files.image_files import GAP, GROUND, TEXT_ROWS, draw_text
from ..geometry import Mesh
from ..scene.copies import DRAWS_PER_POINT, sample_surface
from ..scene.scene import Scene
from ..scene.state import SceneState
from ..trace.hits.closest import count_steps
from ..trace.launch import Caster
from ..trace.world.world import open_world
from ..views.cameras.camera import Camera
from .drawn_scene import DrawnScene

# Quantities that `clbvh render --heatmap` can show, and the title of their bar.
QUANTITIES = {"nodes": "NODE STEPS", "triangles": "PRIMITIVE TESTS"}

# Their fields in `structs.STEPS`.
FIELDS = {"nodes": "node_steps", "triangles": "prim_tests"}

# Evenly spaced stops of the scale, in sRGB. Their lightness (CIE L*) rises by equal steps from 10 to 95.
_STOPS = np.array(
    [(19, 23, 63), (31, 55, 109), (32, 96, 130), (46, 138, 136), (103, 178, 132), (184, 210, 138), (253, 243, 169)],
    np.float64,
)

# The highest colour stands for this percentile: a few pixels of the silhouette would darken all others.
_HIGH_PERCENTILE = 99.5

# Layout of the bar below the picture.
_TICKS = 5


def check_quantity(quantity: str) -> None:
    """Raise `ConfigError` unless this is a key of `QUANTITIES`."""
    if quantity not in QUANTITIES:
        raise ConfigError(f"the heat map must be one of {', '.join(QUANTITIES)}, not '{quantity}'")


def open_counter(
    source: Bvh | SceneState | DrawnScene, device: DeviceInfo | str | int | None = None, layout: str = "bvh2"
) -> Caster:
    """Return a caster for `count_steps`, to be closed; in the layout `bvh2`, counts are the same on all devices.

    Trees of a scene that are not known are built.

    Raises
    ------
    DeviceError
        There is no such device, or the trees do not fit it.
    """
    trees: Sequence[Bvh] = ()
    if isinstance(source, Bvh):
        state, trees = Scene(source.mesh).snapshot(), (source,)
    elif isinstance(source, DrawnScene):
        state, trees = source.state, source.trees
    else:
        state = source
    session = open_device(device)
    try:
        return Caster(session, open_world(session, state, trees or build_shapes(state.shapes, DEFAULT_QUALITY), layout))
    except BaseException:
        session.close()
        raise


def count_picture(
    source: Bvh | DrawnScene, camera: Camera, width: int, height: int, device: DeviceInfo | None = None
) -> NDArray[np.void]:
    """Return (height, width) `structs.STEPS` of the rays of a picture; see `count_steps`."""
    with open_counter(source, device) as caster:
        return count_steps(caster, *camera.rays(width, height))


def draw_heat_map_of(
    source: Bvh | DrawnScene, camera: Camera, width: int, height: int, quantity: str, device: DeviceInfo | None = None
) -> NDArray[np.uint8]:
    """Return the heat map of a picture of this size, of a mesh or of several objects; see `draw_heat_map`."""
    check_quantity(quantity)
    steps = count_picture(source, camera, width, height, device)
    # Outside the circle of a fisheye, pixels have rays that nobody casts.
    counts = np.where(camera.sees(width, height), steps[FIELDS[quantity]], 0)
    return draw_heat_map(counts, quantity)


def draw_heat_map(counts: ArrayLike, quantity: str) -> NDArray[np.uint8]:
    """Return counts as colours, with a colour bar below.

    Parameters
    ----------
    counts : (height, width) int
        The steps of each pixel.
    quantity : str
        ``"nodes"`` or ``"triangles"``: the title of the bar.

    Returns
    -------
    (height + bar, width, 3) uint8
        Linear from 0 to the number at the right end of the bar; higher counts have its colour.

    Raises
    ------
    ConfigError
        Another quantity.
    """
    check_quantity(quantity)
    counts = np.asarray(counts)
    # At the right end of the bar: a multiple of the number of ticks, and at least one for each.
    high, steps = np.percentile(counts, _HIGH_PERCENTILE) if counts.size else 0.0, _TICKS - 1
    highest = max(steps, math.ceil(high / steps) * steps)
    colours = _colour_of(counts / highest)
    return np.concatenate((colours, _draw_bar(counts.shape[1], highest, f"{QUANTITIES[quantity]} PER RAY")))


def _colour_of(shares: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the colours of shares from 0 to 1; others get the colour of the nearer end."""
    stops = np.linspace(0, 1, len(_STOPS))
    channels = [np.interp(shares, stops, _STOPS[:, channel]) for channel in range(3)]
    return np.round(np.stack(channels, axis=-1)).astype(np.uint8)


def _draw_bar(width: int, highest: int, title: str) -> NDArray[np.uint8]:
    """Return a colour bar with a title above and numbers below."""
    scale = max(1, width // 400)
    text_rows = (TEXT_ROWS + 2 * GAP) * scale
    bar = np.full((4 * text_rows, width, 3), GROUND, np.uint8)
    margin = min(20 * scale, width // 4)
    length = max(1, width - 2 * margin)
    colours = _colour_of(np.linspace(0, 1, length)[None])
    bar[2 * text_rows : 3 * text_rows - GAP * scale, margin : margin + length] = colours
    draw_text(bar, title, text_rows // 2, width // 2, scale)
    for tick in range(_TICKS):
        share = tick / (_TICKS - 1)
        draw_text(bar, str(round(highest * share)), 3 * text_rows, margin + round(share * (length - 1)), scale)
    return bar


# Rays of each kind. Means over 50,000 rays are within 0.5 % of means over 500,000, for dragon, bunny and palace.
RAY_COUNT = 50_000

# Distance from the surface at which rays start, in sizes of the mesh: large enough for float32 to resolve.
_LIFT = 1e-5


def measure_rays(
    bvh: Bvh, camera: Camera, aspect: float, *, ray_count: int = RAY_COUNT, device: DeviceInfo | None = None
) -> dict[str, NDArray[np.void]]:
    """Count the node steps and triangle tests of rays.

    Parameters
    ----------
    bvh : Bvh
    camera : Camera
    aspect : float
        Width of its picture divided by the height.
    ray_count : int, optional
        The approximate number of rays of each kind.
    device : DeviceInfo, optional

    Returns
    -------
    dict of str to (n,) `structs.STEPS`
        ``"picture"``: the camera's rays. ``"random"``: uniform in the mesh's box, in any direction. ``"surface"``:
        uniform over the surface, to either side, distributed by the cosine. The same rays for the same mesh and camera.
    """
    generator = np.random.default_rng(0)
    height = max(1, round((ray_count / aspect) ** 0.5))
    width = max(1, round(height * aspect))
    origins, directions = camera.rays(width, height)
    lower, size = bvh.mesh.vertices.min(axis=0), np.ptp(bvh.mesh.vertices, axis=0)
    rays = {
        "picture": (origins.reshape(-1, 3), directions.reshape(-1, 3)),
        "random": (lower + generator.random((ray_count, 3)) * size, generator.normal(size=(ray_count, 3))),
        "surface": _surface_rays(bvh.mesh, ray_count, generator),
    }
    with open_counter(bvh, device) as caster:
        return {kind: count_steps(caster, *cast) for kind, cast in rays.items()}


def mean_steps(steps: NDArray[np.void]) -> dict[str, float]:
    """Return the means of `structs.STEPS`; the `tests` are what the SAH cost estimates, with both costs 1."""
    nodes, leaves, triangles = (
        float(steps[field].mean(dtype=np.float64)) if steps.size else 0.0
        for field in ("node_steps", "leaf_visits", "prim_tests")
    )
    return {"node_steps": nodes, "leaf_visits": leaves, "triangle_tests": triangles, "tests": nodes + triangles}


def _surface_rays(mesh: Mesh, count: int, generator: np.random.Generator) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return rays from points that are uniform over the surface; none for a mesh without area."""
    draws = generator.random((count, DRAWS_PER_POINT))
    try:
        points, normals = sample_surface(mesh.vertices, mesh.faces, draws, name=mesh.name)
    except MeshError:
        return np.empty((0, 3)), np.empty((0, 3))

    # A unit normal plus a point of the unit sphere is distributed by the cosine.
    upward = normals * generator.choice([-1.0, 1.0], (count, 1))
    sphere = generator.normal(size=(count, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    size = float(np.ptp(mesh.vertices, axis=0).max())
    return points + _LIFT * size * upward, sphere + upward
