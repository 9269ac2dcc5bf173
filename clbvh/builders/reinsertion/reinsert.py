"""The step between: subtrees move to where they enlarge the boxes least.

After Bittner, Hapala and Havran, "Fast insertion-based optimization of bounding volume hierarchies" (2013), with the
search of Meister and Bittner, "Parallel reinsertion for bounding volume hierarchy optimization" (2018): it starts where
the subtree is removed and spreads from there, so most of it stays nearby. The measure is the summed area of the
interior nodes' boxes; a subtree that moves keeps its own share, and the leaves' never change.

A subtree that moves below a node changes only nodes below that one, so threads can work on disjoint subtrees.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry.boxes import half_area, load_box, store_box, unite
from ...structs import BOX_LANES, EXPANDED_FIRST, EXPANDED_PRIM_ID
from ...support.compiled import compiled

# A search ends after this many nodes with the best result so far. The mean is about 20 on scans and 40 on overlapping
# boxes; the limit is for triangles that all overlap, where a search would see the whole tree.
_MOST_STEPS = 2048

# Each step of a search takes one entry off the stack and pushes at most two.
_STACK_SIZE = 2 * _MOST_STEPS + 4

# A move must save this share of the moved box's area, or rounding alone could move a subtree to and fro.
_LEAST_GAIN = 1e-6


class _Stack(NamedTuple):
    """Nodes to search, with the saving that is left of each: scratch of `_search`."""

    nodes: NDArray[np.int32]
    savings: NDArray[np.float64]


class _Best(NamedTuple):
    """The result of a search so far: the largest saving, the new sibling that yields it, and the steps taken."""

    saving: float
    sibling: int
    steps: int


@compiled
def reinsert_below(tree, top, order):
    """Try to find a better position for each of the given nodes, one after the other.

    Parameters
    ----------
    tree : ExpandedTree, rearranged
    top : int
        Nodes that are not below this one stay as they are.
    order : (k,) int32
        Nodes below `top`.

    Returns
    -------
    int
        The number of nodes that moved.
    """
    stack = _Stack(np.empty(_STACK_SIZE, np.int32), np.empty(_STACK_SIZE, np.float64))
    moves = 0
    for node in order:
        if tree.parents[node >> 1] == top:
            continue  # the parent is removed with the node, and `top` stays
        sibling = _find_sibling(tree, node, top, stack)
        if sibling > 0:
            _move(tree, node, sibling, top)
            moves += 1
    return moves


@compiled
def _find_sibling(tree, node, top, stack):
    """Return the node that would be the best new sibling of `node`; 0 if `node` should stay."""
    boxes, _, parents = tree
    box = load_box(boxes, node)
    area = half_area(box)
    ancestor = parents[node >> 1]
    # Removing the node removes its parent and shrinks all boxes above.
    rest = load_box(boxes, node ^ 1)
    saved = half_area(load_box(boxes, ancestor))
    best = _search(tree, node ^ 1, box, saved, _Best(_LEAST_GAIN * area, 0, 0), stack)
    while ancestor != top:
        sibling = ancestor ^ 1
        best = _search(tree, sibling, box, saved, best, stack)
        ancestor = parents[ancestor >> 1]
        rest = unite(rest, load_box(boxes, sibling))
        saved += half_area(load_box(boxes, ancestor)) - half_area(rest)
    return best.sibling


@compiled
def _search(tree, start, box, saved, best, stack):
    """Look for a better sibling among `start` and the nodes below it; return the best one so far.

    A position below a node costs the growth of that node's box, and the area of the new parent, which is at least the
    moved box's own area: the remaining saving bounds the search.
    """
    boxes, links, _ = tree
    stack_nodes, stack_savings = stack
    best_saving, best_sibling, steps = best
    area = half_area(box)
    stack_nodes[0], stack_savings[0] = start, saved
    stack_size = 1
    while stack_size > 0 and steps < _MOST_STEPS:
        stack_size -= 1
        saving = stack_savings[stack_size]
        if not saving - area > best_saving:
            continue
        steps += 1
        node = stack_nodes[stack_size]
        node_box = load_box(boxes, node)
        saving -= half_area(unite(node_box, box))
        if saving > best_saving:
            best_saving, best_sibling = saving, node
        child = links[node, EXPANDED_FIRST]
        if child != 0:
            saving += half_area(node_box)
            if saving - area > best_saving:
                stack_nodes[stack_size], stack_savings[stack_size] = child, saving
                stack_nodes[stack_size + 1], stack_savings[stack_size + 1] = child + 1, saving
                stack_size += 2
    return _Best(best_saving, best_sibling, steps)


@compiled
def _move(tree, node, new_sibling, top):
    """Make `node` the sibling of the subtree at `new_sibling`."""
    links, parents = tree.links, tree.parents
    # The old sibling takes the slot of the parent, the new sibling takes the slot of the old one, and the slot of the
    # new sibling becomes the parent of the two.
    old_sibling, parent = node ^ 1, parents[node >> 1]
    _copy_node(links, parents, old_sibling, parent)
    _copy_node(links, parents, new_sibling, old_sibling)
    links[new_sibling, EXPANDED_FIRST] = min(node, old_sibling)
    parents[node >> 1] = new_sibling

    # Boxes above the old position, then above the new one.
    if parent != top:
        _fit_upwards(tree, parents[parent >> 1], top)
    _fit_upwards(tree, new_sibling, top)


@compiled
def _copy_node(links, parents, source, target):
    for lane in range(BOX_LANES):
        links[target, lane] = links[source, lane]
    if links[target, EXPANDED_FIRST] != 0:
        parents[links[target, EXPANDED_FIRST] >> 1] = target


@compiled
def _fit_upwards(tree, node, top):
    boxes, links, parents = tree
    while True:
        child = links[node, EXPANDED_FIRST]
        store_box(boxes, node, unite(load_box(boxes, child), load_box(boxes, child + 1)))
        links[node, EXPANDED_FIRST], links[node, EXPANDED_PRIM_ID] = child, 0
        if node == top:
            return
        node = parents[node >> 1]
