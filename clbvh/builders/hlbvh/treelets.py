"""Treelets: blocks of grid cells whose primitives become one subtree each.

All cells of a block share the first bits of their Morton codes, so a block is a cube, or two or four
cubes. Dense regions get small blocks, sparse ones large blocks.
"""

from __future__ import annotations

import numpy as np

from ...geometry.boxes import store_box
from ...structs import PRIM_REF_ID
from ...support.compiled import compiled
from ..prim_refs import box_of


@compiled
def cut_treelets(counts, limit, treelet_of_cell, first_cells):
    """Gather the cells into the largest blocks that hold at most `limit` primitives, or that are one cell.

    Parameters
    ----------
    counts : (cells,) int
        Primitives in each cell, in Morton order; a power of two of cells.
    limit : int
    treelet_of_cell : (cells,) int32, written
    first_cells : (cells,) int64, written
        The first cell of each treelet.

    Returns
    -------
    int
        Number of treelets. None is empty.
    """
    cell_count = len(counts)
    sums = np.zeros(cell_count + 1, np.int64)
    for cell in range(cell_count):
        sums[cell + 1] = sums[cell] + counts[cell]

    treelet_count = 0
    cell = 0
    while cell < cell_count:
        # Blocks begin at multiples of their size.
        size = cell & -cell if cell > 0 else cell_count
        while size > 1 and sums[cell + size] - sums[cell] > limit:
            size >>= 1
        if sums[cell + size] > sums[cell]:
            treelet_of_cell[cell : cell + size] = treelet_count
            first_cells[treelet_count] = cell
            treelet_count += 1
        cell += size
    return treelet_count


@compiled
def fill_treelets(mesh_slice, cells, treelet_of_cell, next_slots, refs):
    """Write the primitive references of one slice of the mesh into their treelets, in their order.

    Parameters
    ----------
    mesh_slice : MeshSlice
    cells : (F,) uint16
        The cell of each primitive.
    treelet_of_cell
        See `cut_treelets`.
    next_slots : (treelets,) int64, overwritten
        The slot of the slice's first primitive reference in each treelet.
    refs : (2F, 8) float32, written
    """
    vertices, faces = mesh_slice.vertices, mesh_slice.faces
    ref_ints = refs.view(np.int32)
    for prim in range(mesh_slice.begin, mesh_slice.end):
        treelet = treelet_of_cell[cells[prim]]
        slot = next_slots[treelet]
        next_slots[treelet] = slot + 1
        store_box(refs, slot, box_of(vertices, faces, prim))
        ref_ints[slot, PRIM_REF_ID] = prim
