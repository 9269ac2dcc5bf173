"""The trees of a scene's geometries and of its merged meshes as arrays, and where each begins in the joined ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...errors import SceneError
from ...geometry import Mesh
from ...geometry.spheres import Shape
from ...layouts.device_arrays import DeviceArrays, list_prims, make_device_arrays
from ...scene.state import SceneState
from ...structs import PRIM_KINDS
from .merging import Merging


def arrange_geometries(
    state: SceneState, trees: Sequence[Bvh | None] | None, merging: Merging, layout: str
) -> list[DeviceArrays | None]:
    """Return the arrays of each geometry, and then of each merged mesh.

    Parameters
    ----------
    state : SceneState
    trees : sequence of Bvh or None, or None
        One for each geometry; None for one whose instances are merged, which has no arrays. None for all: the arrays
        have no trees, whatever the layout, and nothing is merged.
    merging : Merging
    layout : str
    """
    if trees is None:
        return [list_prims(shape) for shape in state.shapes]
    arrays = [
        None if bvh is None else make_device_arrays(bvh, layout, shape)
        for bvh, shape in zip(trees, state.shapes, strict=True)
    ]
    return arrays + [
        make_device_arrays(merged.bvh, layout, face_numbers=merged.face_numbers()) for merged in merging.meshes
    ]


def list_parts(state: SceneState, merging: Merging, arrays: Sequence[DeviceArrays | None]) -> NDArray[np.int32]:
    """Return where the arrays of `arrange_geometries` are in the joined ones, (n, 4), see `make_records`.

    Raises
    ------
    SceneError
        More nodes or blocks than int32 counts.
    """
    rows = []
    first_node, first_blocks = 0, [0] * len(PRIM_KINDS)
    shapes: list[Shape] = [*state.shapes, *(merged.mesh for merged in merging.meshes)]
    for shape, part in zip(shapes, arrays, strict=True):
        kind = PRIM_KINDS["triangles" if isinstance(shape, Mesh) else "spheres"]
        node_count, block_count = (0, 0) if part is None else (len(part.nodes), len(part.blocks))
        rows.append((first_node, first_blocks[kind], block_count, kind))
        first_node += node_count
        first_blocks[kind] += block_count
    most = np.iinfo(np.int32).max
    if max(first_node, *first_blocks) > most:
        raise SceneError(f"the scene has {first_node:,} nodes, and the device counts up to {most:,}")
    return np.array(rows, np.int32)


def blocks_by_kind(
    parts: NDArray[np.int32], arrays: Sequence[DeviceArrays | None]
) -> dict[str, list[NDArray[np.void]]]:
    """Return the blocks of all arrays by the kind of their primitives, see `structs.PRIM_KINDS`."""
    blocks: dict[str, list[NDArray[np.void]]] = {name: [] for name in PRIM_KINDS}
    names = list(PRIM_KINDS)
    for part, kind in zip(arrays, parts[:, 3].tolist(), strict=True):
        if part is not None:
            blocks[names[kind]].append(part.blocks)
    return blocks
