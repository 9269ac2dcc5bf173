"""Queries of Dask arrays, and pictures rendered by the workers of a Dask cluster.

Nothing is computed before it is asked for. A scene goes to the workers by its name, or by its content once; each opens
it once. Answers are those of a `Tracer`, to the last bit, whatever the chunks. See docs/growing.md.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from operator import itemgetter
from typing import Any, TypeAlias

import dask.array as da
import numpy as np
from dask.delayed import Delayed, delayed
from numpy.typing import NDArray

from ..errors import QueryError
from ..files.open_scene import SceneLike
from ..rendering.options import RenderOptions
from ..rendering.renderer import Renderer
from ..rendering.scene_ref import SceneRef, open_renderer, open_tracer
from ..trace.tracer import Tracer
from ..views.view import View

__all__ = ["ambient_occlusion", "any_hit", "closest_hit", "closest_point", "count_hits", "render_frames"]

Source: TypeAlias = SceneRef | Tracer | SceneLike
"""What rays are cast at: a `SceneRef`; a `Tracer`, as it is now; or anything that `SceneRef` or `embed` takes."""

_HIT = np.dtype([("t", "f8"), ("prim_id", "i4"), ("instance_id", "i4"), ("u", "f8"), ("v", "f8")])
_CLOSEST_POINT = np.dtype([("distance", "f8"), ("point", "f8", 3), ("prim_id", "i4"), ("instance_id", "i4")])


def closest_hit(
    source: Source, origins: Any, directions: Any, *, t_min: Any = 0.0, t_max: Any = np.inf, mask: Any = None
) -> dict[str, da.Array]:
    """Return the nearest hit of each ray; see `Tracer.closest_hit`.

    Parameters
    ----------
    source : SceneRef, Tracer, or what a Tracer takes
        A path becomes a `SceneRef`, and anything in memory one node of the graph.
    origins, directions : (..., 3) dask array, or anything that becomes one
        Broadcast against each other as in numpy; the last axis becomes one chunk.
    t_min, t_max, mask : number or (...,) array, optional
        Arrays broadcast to the rays.

    Returns
    -------
    dict of str to dask array
        t, u, v : (...,) float64; prim_id, instance_id : (...,) int32. Chunked as the rays are.

    Raises
    ------
    QueryError
        A last axis of another length than 3. Other errors of the query come from the workers.

    Examples
    --------
    >>> import clbvh
    >>> import dask.array as da
    >>> from clbvh.integrations.dask import closest_hit
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> hits = closest_hit(ball, da.zeros((4, 3), chunks=(2, 3)) + [0, 0, 5], [[0, 0, -1]])
    >>> hits["t"].chunks, hits["prim_id"].dtype
    (((2, 2),), dtype('int32'))
    >>> hits["t"].compute().round(3)
    array([4., 4., 4., 4.])
    """
    limits = {"t_min": t_min, "t_max": t_max, "mask": mask}
    return _ask("closest_hit", source, (origins, directions), limits, _HIT)


def any_hit(
    source: Source, origins: Any, directions: Any, *, t_min: Any = 0.0, t_max: Any = np.inf, mask: Any = None
) -> da.Array:
    """Return (...,) bool: whether each ray hits anything; see `closest_hit`.

    Examples
    --------
    >>> import clbvh
    >>> import dask.array as da
    >>> from clbvh.integrations.dask import any_hit
    >>> points, suns = da.zeros((4, 3), chunks=(2, 3)), da.asarray([[0, 0, 1], [0, 1, 0]])
    >>> any_hit(clbvh.make_shape("icosphere", triangles=320), points[:, None], suns[None]).compute().shape
    (4, 2)
    """
    limits = {"t_min": t_min, "t_max": t_max, "mask": mask}
    return _ask("any_hit", source, (origins, directions), limits, np.dtype(bool))


def count_hits(
    source: Source, origins: Any, directions: Any, *, t_min: Any = 0.0, t_max: Any = np.inf, mask: Any = None
) -> da.Array:
    """Return (...,) int32: the number of hits of each ray; see `closest_hit`.

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.integrations.dask import count_hits
    >>> count_hits(clbvh.make_shape("icosphere", triangles=320), [[0, 0, 5]], [0, 0, -1]).compute()
    array([2], dtype=int32)
    """
    limits = {"t_min": t_min, "t_max": t_max, "mask": mask}
    return _ask("count_hits", source, (origins, directions), limits, np.dtype(np.int32))


def closest_point(source: Source, points: Any, *, mask: Any = None) -> dict[str, da.Array]:
    """Return the nearest point of the surface; see `Tracer.closest_point`, and `closest_hit` for the source.

    Parameters
    ----------
    points : (..., 3) dask array, or anything that becomes one
    mask : int or (...,) array, optional

    Returns
    -------
    dict of str to dask array
        distance : (...,) float64; point : (..., 3) float64; prim_id, instance_id : (...,) int32.

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.integrations.dask import closest_point
    >>> closest = closest_point(clbvh.make_shape("icosphere", triangles=320), [[0, 0, 5]])
    >>> closest["distance"].compute().round(3), closest["point"].shape
    (array([4.]), (1, 3))
    """
    return _ask("closest_point", source, (points,), {"mask": mask}, _CLOSEST_POINT)


def ambient_occlusion(
    source: Source, points: Any, normals: Any, *, max_distance: Any = np.inf, mask: Any = None, **sampling: Any
) -> da.Array:
    """Return (...,) float64: how open the surroundings of points are; see `Tracer.ambient_occlusion`.

    All axes but the first become one chunk: a point's rays depend on its number in the whole array.

    Parameters
    ----------
    source : SceneRef, Tracer, or what a Tracer takes
        See `closest_hit`.
    points, normals : (..., 3) dask array, or anything that becomes one
    max_distance, mask : number or (...,) array, optional
    **sampling
        rays, seed and offset.

    Examples
    --------
    >>> import clbvh
    >>> import dask.array as da
    >>> from clbvh.integrations.dask import ambient_occlusion
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> ambient_occlusion(ball, da.asarray([[0, 0, 2.0], [0, 0, 0]]), [0, 0, 1]).compute()
    array([1., 0.])
    """
    vectors = da.asarray(points), da.asarray(normals)
    numbers: dict[str, Any] = {"max_distance": max_distance, "mask": mask}
    shape = da.core.broadcast_shapes(*(each.shape[:-1] for each in vectors))
    if shape:
        row, rank = math.prod(shape[1:]), len(shape)
        chunks = next(each.chunks[0] for each in vectors if each.ndim > rank and each.shape[0] == shape[0])
        starts = da.arange(0, shape[0] * row, row, chunks=(chunks,))
        numbers["first_number"] = starts.reshape(-1, *(1,) * (rank - 1))
    return _ask("ambient_occlusion", source, vectors, numbers, np.dtype(float), min(1, len(shape)), **sampling)


def render_frames(source: Any, views: Sequence[View], options: RenderOptions | None = None) -> list[Delayed]:
    """Return delayed pictures of a scene, one for each view.

    Parameters
    ----------
    source : SceneRef, Renderer, or what a Renderer takes
        A path becomes a `SceneRef`, and anything in memory one node of the graph.
    views : sequence of View
    options : RenderOptions, optional
        By default trees come from the user's cache. A renderer has its own.

    Returns
    -------
    list of dask.delayed.Delayed
        Each is (height, width, 3) uint8, the `rgb` of a `Picture`; with `alpha` as the fourth channel where the view is
        transparent.

    Examples
    --------
    >>> import clbvh
    >>> import dask
    >>> from clbvh.integrations.dask import render_frames
    >>> view = clbvh.View(width=64, height=48)
    >>> frames = render_frames(clbvh.SceneRef("knot"), [view, view.changed(side="top")])
    >>> [frame.shape for frame in dask.compute(*frames)]
    [(48, 64, 3), (48, 64, 3)]
    """
    node, draw = _node(source), delayed(_draw, pure=True)
    return [draw(node, view, options) for view in views]


def _draw(source: SceneRef | Renderer, view: View, options: RenderOptions | None) -> NDArray[np.uint8]:
    renderer = source if isinstance(source, Renderer) else open_renderer(source, options)
    picture = renderer.render(view)
    return np.dstack((picture.rgb, picture.alpha)) if view.transparent else picture.rgb


def _ask(
    query: str, source: Source, vectors: Any, numbers: Any, answer: np.dtype, whole_from: int | None = None, **more: Any
) -> Any:
    """Return the answers of a method of `Tracer`, block by block.

    Parameters
    ----------
    query : str
        Name of the method.
    source : SceneRef, Tracer, or what a Tracer takes
    vectors : sequence of (..., 3) arrays
        The arguments of the method.
    numbers : mapping of str to number or array
        Named arguments that broadcast to the leading shape of the vectors.
    answer : numpy.dtype
        Of an array; or a struct of the attributes that become arrays each.
    whole_from : int, optional
        Axes of the answers from this one on are one chunk.
    **more
        Other arguments of the method.
    """
    arrays = [da.asarray(each) for each in vectors]
    varying = {name: da.asarray(each) for name, each in numbers.items() if isinstance(each, da.Array) or np.ndim(each)}
    rank = max(each.ndim for each in arrays) - 1
    for each in arrays:
        if each.shape[-1:] != (3,):
            raise QueryError(f"{query} takes arrays of shape (..., 3), not {each.shape}")
    for name, each in varying.items():
        if each.ndim > rank:
            raise QueryError(f"{name} must broadcast to an answer of {rank} axes, and has {each.ndim}")
    # The answers' axes, and the vectors' last one.
    axes = [range(rank + 1 - each.ndim, rank + 1) for each in arrays]
    axes += [range(rank - each.ndim, rank) for each in varying.values()]
    whole = rank if whole_from is None else whole_from
    pairs: list[Any] = []
    for each, labels in zip((*arrays, *varying.values()), axes, strict=True):
        pairs += each.rechunk({axis: -1 for axis, label in enumerate(labels) if label >= whole}), tuple(labels)
    given = {name: each for name, each in numbers.items() if name not in varying} | more
    found = da.blockwise(
        _answer, range(rank), _node(source), None, *pairs, dtype=answer, meta=np.empty((0,) * rank, answer),
        token=query, query=query, names=(None,) * len(arrays) + tuple(varying), given=given, answer=answer,
    )  # fmt: skip
    if answer.names is None:
        return found
    # The blocks of `found` are dicts: nothing is copied into structs and out of them.
    fields = {}
    for name in answer.names:
        dtype = answer[name]
        axis: Any = {"new_axis": rank, "chunks": (*found.chunks, dtype.shape)} if dtype.shape else {}
        meta = np.empty((0,) * (rank + len(dtype.shape)), dtype.base)
        fields[name] = found.map_blocks(itemgetter(name), dtype=dtype.base, meta=meta, **axis)
    return fields


def _answer(source: Any, *blocks: Any, query: str, names: Any, given: Any, answer: np.dtype) -> Any:
    """Return the answers of one block; vectors have no names, and come in lists of one, along the axis that goes."""
    tracer = source if isinstance(source, Tracer) else open_tracer(source)
    vectors = [block[0] for name, block in zip(names, blocks, strict=True) if name is None]
    numbers = {name: block for name, block in zip(names, blocks, strict=True) if name is not None}
    if "first_number" in numbers:
        numbers["first_number"] = int(numbers["first_number"].flat[0])
    found = getattr(tracer, query)(*vectors, **numbers, **given)
    return found if answer.names is None else {name: getattr(found, name) for name in answer.names}


def _node(source: Any) -> Any:
    """Return what tasks take for a source: a small reference, or a node of the graph for anything large."""
    if isinstance(source, str | os.PathLike):
        source = SceneRef(source)
    elif not isinstance(source, SceneRef | Tracer | Renderer):
        source = SceneRef.embed(source)
    is_small = isinstance(source, SceneRef) and source.content is None
    return source if is_small else delayed(source, pure=True, traverse=False)
