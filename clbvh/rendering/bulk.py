"""The bulk of a mesh or a scene: all but strays, which would make everything else small in a picture of the whole."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh, Spheres
from ..geometry.spheres import Shape
from ..geometry.spikes import LEAST_GAP as SPIKE_GAP, find_spikes
from ..geometry.strays import LEAST_GAP, find_strays
from .view_bounds import SceneExtent

# Primitives of the first look, which finds out whether there may be strays; spread evenly over the list of them.
_SAMPLE = 2000

# Shares of the sample at either end of an axis that may be strays: more than three times as many as there can be, so
# that chance hides none.
_ENDS = 0.03

# Boxes of stray primitives, over all instances, that are looked at one by one.
_MOST_PIECES = 1_000_000


class Bulk(NamedTuple):
    """What a picture of the whole frames.

    Attributes
    ----------
    extent : Mesh or SceneExtent
    note : str or None
        What is left out, for the user; None if nothing is.
    """

    extent: Mesh | SceneExtent
    note: str | None


def find_bulk(extent: Mesh | SceneExtent) -> Bulk:
    """Return the bulk of a mesh or of a scene; see `clbvh.geometry.strays` and `spikes` for what is no part of it.

    Complexity: of a mesh without strays the time for some thousand triangles.

    Examples
    --------
    >>> import clbvh
    >>> import numpy as np
    >>> from clbvh.rendering.bulk import find_bulk
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> corners = np.concatenate((ball.vertices, [[90, 0, 0], [90, 0.1, 0], [90, 0, 0.1]]))
    >>> faces = np.concatenate((ball.faces, [[162, 163, 164]]))
    >>> find_bulk(clbvh.Mesh.from_arrays(corners, faces)).note
    '1 of 321 triangles (0.3 %) is far away from the others and is left out of the frame'
    """
    return _bulk_of_scene(extent) if isinstance(extent, SceneExtent) else _bulk_of_mesh(extent)


def _bulk_of_mesh(mesh: Mesh) -> Bulk:
    is_stray = _find_stray_prims(mesh)
    if is_stray is None:
        return Bulk(mesh, None)
    count = int(np.count_nonzero(is_stray))
    # Vertices without triangles are not framed, and nobody misses them.
    return Bulk(_mesh_without(mesh, is_stray), _describe(count, mesh.face_count, "triangle") if count else None)


def _bulk_of_scene(extent: SceneExtent) -> Bulk:
    shapes, geometry_ids, transforms = extent.shapes, extent.geometry_ids, extent.transforms
    instance_counts = np.bincount(geometry_ids, minlength=len(shapes))
    bulks: list[Shape] = list(shapes)
    pieces: list[NDArray[np.floating]] = []
    for number, shape in enumerate(shapes):
        is_stray = _find_stray_prims(shape)
        pieces.append(np.empty((0, 2, 3)))
        if is_stray is not None and np.count_nonzero(is_stray) * instance_counts[number] <= _MOST_PIECES:
            bulks[number] = _without(shape, is_stray)
            lower, upper, _ = _measure_prims(shape, is_stray)
            pieces[number] = shape.origin + np.stack((lower, upper), axis=1) / shape.scale

    # One item for the bulk of each instance, and one for each of its stray primitives.
    boxes = np.stack([_box_of(shape) for shape in bulks])[geometry_ids]
    owners = np.arange(len(geometry_ids))
    piece_counts = np.array([len(each) for each in pieces])[geometry_ids]
    owners = np.concatenate((owners, np.repeat(owners, piece_counts)))
    if piece_counts.any():
        boxes = np.concatenate((boxes, *(pieces[geometry] for geometry in geometry_ids)))
    lower, upper = _place(boxes, transforms[owners])
    counts = np.array([shape.prim_count for shape in bulks], np.float64)[geometry_ids]
    weights = np.concatenate((counts, np.ones(len(owners) - len(counts))))
    strays = find_strays(lower, upper, weights, np.zeros(len(weights)))
    if strays.any():
        areas = np.array([_area_of(shape) for shape in bulks])[geometry_ids]
        areas = areas * np.cbrt(np.abs(np.linalg.det(transforms[:, :3, :3]))) ** 2
        strays = find_strays(lower, upper, weights, np.concatenate((areas, np.zeros(len(weights) - len(areas)))))
    if not strays.any():
        return Bulk(extent, None)

    is_kept = ~strays[: len(geometry_ids)]
    is_piece_kept = np.zeros(len(geometry_ids), bool)
    is_piece_kept[owners[len(geometry_ids) :][~strays[len(geometry_ids) :]]] = True
    # An instance with a primitive that is to be seen is framed as a whole.
    is_whole = is_piece_kept | (piece_counts == 0)
    count = int(weights[strays].sum())
    kept = np.flatnonzero(is_kept | is_piece_kept)
    ids = np.where(is_whole, geometry_ids, len(shapes) + geometry_ids)[kept]
    all_shapes = (*shapes, *bulks)
    used, ids = np.unique(ids, return_inverse=True)
    bulk = SceneExtent([all_shapes[each] for each in used], ids, transforms[kept])
    return Bulk(bulk, _describe(count, int(weights.sum()), "primitive"))


def _describe(count: int, total: int, name: str) -> str:
    share = 100 * count / total
    verb = "is" if count == 1 else "are"
    shown = f"{share:.1f}" if share >= 0.1 else f"{share:.2g}"
    return (
        f"{count:,} of {total:,} {name}s ({shown} %) {verb} far away from the others and {verb} left out of the frame"
    )


def _find_stray_prims(shape: Shape) -> NDArray[np.bool_] | None:
    """Return which primitives are strays; None if there are neither strays nor vertices without faces far away."""
    whole = np.linalg.norm(np.ptp(shape.local_box.astype(np.float64), axis=0))
    step = -(-shape.prim_count // _SAMPLE)
    lower, upper, _ = _measure_prims(shape, slice(None, None, step))
    begin, end = np.quantile(np.concatenate((lower, upper)), [_ENDS, 1 - _ENDS], axis=0)
    if not whole >= LEAST_GAP * np.linalg.norm(end - begin) > 0:
        return None
    # The middle counts as one part; each primitive outside it is a part of its own.
    lower, upper, areas = _measure_prims(shape, slice(None))
    is_inside = ((lower >= begin) & (upper <= end)).all(axis=1)
    around = np.flatnonzero(~is_inside)
    strays = find_strays(
        np.concatenate((begin[None], lower[around])),
        np.concatenate((end[None], upper[around])),
        np.concatenate(([np.count_nonzero(is_inside)], np.ones(len(around)))),
        np.concatenate(([areas[is_inside].sum()], areas[around])),
    )
    is_stray = np.zeros(shape.prim_count, bool)
    is_stray[around[strays[1:]]] = True
    bulk = upper[~is_stray].max(axis=0) - lower[~is_stray].min(axis=0)
    if isinstance(shape, Mesh) and np.linalg.norm(bulk) >= SPIKE_GAP * np.linalg.norm(end - begin):
        is_stray |= find_spikes(shape, begin, end)
        bulk = upper[~is_stray].max(axis=0) - lower[~is_stray].min(axis=0)
    return is_stray if is_stray.any() or whole >= LEAST_GAP * np.linalg.norm(bulk) else None


def _measure_prims(shape: Shape, chosen: slice | NDArray[np.bool_]) -> tuple[NDArray[np.float64], ...]:
    """Return the lower and the upper corners of boxes around primitives, (n, 3), and areas, (n,), in local units."""
    if not isinstance(shape, Mesh):
        centres = (shape.centres[chosen] - shape.origin) * shape.scale
        radii = shape.radii[chosen].astype(np.float64)[:, None] * shape.scale
        return centres - radii, centres + radii, 4 * np.pi * radii[:, 0] ** 2
    corners = shape.local_vertices[shape.faces[chosen]].astype(np.float64)
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners.min(axis=1), corners.max(axis=1), np.linalg.norm(crosses, axis=1) / 2


def _without(shape: Shape, is_stray: NDArray[np.bool_]) -> Shape:
    """Return a shape without strays, and without vertices that no other face uses."""
    if not isinstance(shape, Mesh):
        return Spheres(shape.centres[~is_stray], shape.radii[~is_stray], name=shape.name)
    return _mesh_without(shape, is_stray)


def _mesh_without(mesh: Mesh, is_stray: NDArray[np.bool_]) -> Mesh:
    vertices, faces = np.unique(mesh.faces[~is_stray], return_inverse=True)
    return Mesh.from_arrays(mesh.vertices[vertices], faces.reshape(-1, 3), name=mesh.name)


def _box_of(shape: Shape) -> NDArray[np.float64]:
    """Return (2, 3) float64: the box around a shape, in its coordinates."""
    return shape.origin + shape.local_box.astype(np.float64) / shape.scale


def _area_of(shape: Shape) -> float:
    """Return the surface, in square units of the shape's coordinates."""
    return float(_measure_prims(shape, slice(None))[2].sum()) / shape.scale**2


def _place(boxes: NDArray[np.floating], transforms: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Return the corners of boxes around transformed boxes, (n, 3) each."""
    middles, halves = boxes.mean(axis=1), (boxes[:, 1] - boxes[:, 0]) / 2
    centres = np.einsum("nij,nj->ni", transforms[:, :3, :3], middles) + transforms[:, :3, 3]
    reach = np.einsum("nij,nj->ni", np.abs(transforms[:, :3, :3]), halves)
    return centres - reach, centres + reach
