"""Work on the host that needs every compiled function of it: trees of all builders, files, measures."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ..builders.build import build, build_shape
from ..builders.ladder import LADDER
from ..builders.options import DEFAULT_QUALITY, FAST_QUALITY, HIGH_QUALITY, MAX_DEPTH
from ..bvh import Bvh, validate_tree
from ..geometry import Mesh, Spheres, load_mesh
from ..geometry.appearance.normals import smooth_normals_by_angle
from ..geometry.shapes.make_shape import make_shape
from ..layouts.device_arrays import make_device_arrays
from ..rendering.framing import frame_mesh
from ..rendering.heat_map import draw_heat_map_of, measure_rays
from ..scene.contents import SceneContents
from ..stats import measure_tree
from ..structs import LAYOUT_WIDTHS, WIDE_NODES
from ..study.ladder_work import count_ladder_work
from ..trace.oracle.scene_visits import SceneTraversal
from ..trace.oracle.visits import count_wide_visits

# Enough for a top with several subtrees.
TRIANGLES = 3_000
_THRESHOLD = 500

# More triangles than a block of any layout has.
_LARGE_LEAF = 64

# Of pictures whose rays are counted.
_SIDE = 8

_QUALITIES = (DEFAULT_QUALITY, FAST_QUALITY, HIGH_QUALITY)


def make_mesh() -> Mesh:
    """Return the mesh of a warm-up: closed, so that all queries have answers."""
    return make_shape("knot", triangles=TRIANGLES)


def list_host_work(*, quick: bool) -> list[tuple[str, Callable[[], object]]]:
    """Return names and work; `quick` leaves out the report's builders and the cost of rays, which only studies need."""
    mesh = make_mesh()
    work: list[tuple[str, Callable[[], object]]] = [
        ("mesh files", _load_files),
        *((f"build, quality {quality}", partial(_build_all, mesh, quality)) for quality in _QUALITIES),
        ("layouts", partial(_arrange_all, mesh)),
        ("spheres", _arrange_spheres),
        ("smooth normals", partial(smooth_normals_by_angle, mesh)),
        ("refit, save, load, validate", partial(_for_both, mesh, _use_tree)),
        ("statistics of a tree", partial(_for_both, mesh, measure_tree)),
    ]
    if not quick:
        work.append(("cost of rays", partial(_for_both, mesh, _measure_rays)))
        work.append(("cost of rays in scenes", partial(_count_in_scene, mesh)))
        work.append(("builders of the ladder", partial(_build_ladder, mesh)))
        work.append(("counts of the study", partial(_for_both, mesh, _count_for_study)))
    return work


def _build_all(mesh: Mesh, quality: str) -> None:
    """Build a tree as one task, one with a top and several tasks, and one of a single node."""
    build(mesh, quality=quality)
    build(mesh, quality=quality, task_threshold=_THRESHOLD)
    build(_make_triangle(), quality=quality)


def _build_ladder(mesh: Mesh) -> None:
    for name in LADDER:
        build(mesh, builder=name, task_threshold=_THRESHOLD)
        build(_make_triangle(), builder=name)


def _arrange_all(mesh: Mesh) -> None:
    """Arrange trees for devices: an ordinary one, one whose leaves are too large for a layout, and a single leaf."""
    for bvh in (build(mesh), build(mesh, leaf_size=_LARGE_LEAF, traversal_cost=_LARGE_LEAF), build(_make_triangle())):
        for layout in LAYOUT_WIDTHS:
            make_device_arrays(bvh, layout)


def _arrange_spheres() -> None:
    """Arrange a tree over spheres, and one that is a single leaf."""
    for spheres in (Spheres(make_mesh().vertices, 1.0), Spheres(np.eye(3), 1.0)):
        bvh = build_shape(spheres)
        for layout in LAYOUT_WIDTHS:
            make_device_arrays(bvh, layout, spheres)


def _for_both(mesh: Mesh, use: Callable[[Bvh], object]) -> None:
    """Use an ordinary tree, and a single node, whose fields are contiguous arrays: another type."""
    use(build(mesh))
    use(build(_make_triangle()))


def _make_triangle() -> Mesh:
    return Mesh.from_arrays(np.eye(3), [[0, 1, 2]])


def _measure_rays(bvh: Bvh) -> None:
    camera = frame_mesh(bvh.mesh, aspect=1.0)
    measure_rays(bvh, camera, 1.0)
    draw_heat_map_of(bvh, camera, _SIDE, _SIDE, "nodes")


def _count_in_scene(mesh: Mesh) -> None:
    contents = SceneContents()
    for shape in (mesh, Spheres(mesh.vertices, 0.1)):
        contents.place(contents.add(shape))
    # Any tree of two primitives does for the two instances.
    pair = Mesh.from_arrays(2 * np.eye(6, 3) - 1, [[0, 1, 2], [3, 4, 5]])
    trees = [build_shape(shape) for shape in (mesh, Spheres(mesh.vertices, 0.1))]
    traversal = SceneTraversal(contents.snapshot(), trees, build(pair, leaf_size=1))
    origins, directions = frame_mesh(mesh, aspect=1.0).rays(_SIDE, _SIDE)
    traversal.count_visits(origins.reshape(-1, 3), directions.reshape(-1, 3))


def _count_for_study(bvh: Bvh) -> None:
    origins, directions = frame_mesh(bvh.mesh, aspect=1.0).rays(_SIDE, _SIDE)
    for width in WIDE_NODES:
        count_wide_visits(bvh, width, origins.reshape(-1, 3), directions.reshape(-1, 3))
    for name in LADDER:
        count_ladder_work(bvh.mesh, name)


def _load_files() -> None:
    """Read text files, the only kinds that need compiled functions."""
    with TemporaryDirectory(prefix="clbvh-") as folder:
        path = Path(folder) / "mesh.ply"
        lines = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {axis}" for axis in "xyz")]
        lines += ["element face 1", "property list uchar int vertex_indices", "end_header"]
        path.write_text("\n".join([*lines, "0 0 0", "1 0 0", "0 1 0", "3 0 1 2", ""]))
        load_mesh(path)
        path = Path(folder) / "mesh.obj"
        path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        load_mesh(path)


def _use_tree(bvh: Bvh) -> None:
    validate_tree(bvh, max_depth=MAX_DEPTH)
    for dtype in (np.float32, np.float64):
        bvh.refit(bvh.mesh.vertices.astype(dtype))
    with TemporaryDirectory(prefix="clbvh-") as folder:
        path = Path(folder) / "mesh.tree"
        bvh.save(path)
        Bvh.load(path, bvh.mesh)
