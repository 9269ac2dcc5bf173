"""The rule by which instances are merged on the device: which ones gain by it, and lose nothing.

Owns the choice of the groups. `merging.py` makes one mesh of each.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...scene.state import SceneState
from ...structs import ALL_PRIM_BITS, PRIM_KINDS
from ..hits.scene_arrays import SceneArrays

# Least number of instances that gain by it. Of knots side by side, picture rays and random ones take 1.02 to 1.1 times
# as long apart as merged for 2 of 50,000 triangles, 1.1 to 1.25 times for 4 of 20,000, 1.4 times for 64 of 20,000 and
# 2 times for 2,000 of 500; where the boxes of 64 overlap, 4 times (CPU time on a 2-core x86-64 server, PoCL).
LEAST_COUNT = 4

# A part of a merged mesh is at least this share of it, by the largest sides of their boxes. So rounding a corner to
# float32, which moves it by 2^-24 of half the size of the merged mesh, moves it by 2^-17 of that of the part at most. A
# field of 45 x 45 balls is one mesh from 2^-6 on, and then traced 1.5 to 1.7 times as fast as apart; as 5 meshes, with
# 2^-5, 1.1 to 1.3 times (CPU time on a 2-core x86-64 server, PoCL).
_LEAST_SHARE = 2.0**-7

# A part that its map flattens is at least this thick beside the merged mesh. So rounding moves a corner by 2^-10 of the
# thickness at most, and a ray meets the side from which it comes: of balls of this thickness, 2 of 10^5 rays met the
# back in place of the front; a tenth as thick, 22, and a hundredth, 709. An instance resolves its own axes, however
# flat.
_LEAST_THICKNESS = 2.0**-15

# A part is at least this share of the scene, and its matrix turns and flattens by this factor at most. Others would be
# refused as instances, or nearly, and any part may have to become one.
_LEAST_OF_SCENE = 2.0**-30
_MOST_CONDITION = 2.0**20


def find_groups(state: SceneState, arrays: SceneArrays) -> list[NDArray[np.int64]]:
    """Return the instances that are to be merged with each other.

    Parameters
    ----------
    state : SceneState
    arrays : SceneArrays
        Of the state.

    Returns
    -------
    list of (n,) int64
        The ids of each group, ascending: at least `LEAST_COUNT` triangle meshes that are placed once, have the same
        mask, and are mirrored or not.
    """
    if state.instance_count < LEAST_COUNT:
        return []
    middles = np.einsum("nij,nj->ni", arrays.linear, arrays.origin[arrays.geometry_id]) + arrays.offset
    halves = np.einsum("nij,nj->ni", np.abs(arrays.linear), arrays.half_size[arrays.geometry_id])
    candidates = np.flatnonzero(_may_be_merged(state, arrays, middles, halves))
    groups = []
    sizes = _measure_sizes(arrays, halves)
    kinds = np.column_stack((state.masks[candidates], arrays.is_mirrored[candidates]))
    for kind in np.unique(kinds, axis=0):
        alike = candidates[(kinds == kind).all(axis=1)]
        for group in _find_alike_in_size(alike, sizes, middles, halves):
            group = _with_short_numbers(group, state)
            if len(group) >= LEAST_COUNT:
                groups.append(group)
    return groups


def _may_be_merged(
    state: SceneState, arrays: SceneArrays, middles: NDArray[np.float64], halves: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return (n,) bool: triangle meshes that are placed once, and that are neither tiny nor flattened by far."""
    is_single = np.bincount(state.geometry_ids, minlength=state.geometry_count)[state.geometry_ids] == 1
    is_mesh = arrays.kind[arrays.geometry_id] == PRIM_KINDS["triangles"]
    scene = _half_size(np.arange(len(middles)), middles, halves)
    is_large = halves.max(axis=1) >= _LEAST_OF_SCENE * scene
    with np.errstate(over="ignore", invalid="ignore"):  # infinite for one that is flattened by far
        condition = np.einsum("nij,njk->nik", np.abs(arrays.linear), np.abs(arrays.inverse)).sum(axis=2).max(axis=1)
    return np.asarray(is_single & is_mesh & is_large & (condition <= _MOST_CONDITION) & (halves.max(axis=1) > 0))


def _measure_sizes(arrays: SceneArrays, halves: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n,) float64: the sizes of which `_LEAST_SHARE` speaks, less where a part is too flat for its size."""
    half_sizes = arrays.half_size[arrays.geometry_id]
    # Half of what separates the planes -1 and 1 of each axis of the object in the world.
    with np.errstate(over="ignore", divide="ignore"):
        stretches = 1.0 / np.linalg.norm(arrays.inverse, axis=2)
    thicknesses = half_sizes * stretches * (_LEAST_SHARE / _LEAST_THICKNESS)
    # A mesh that is flat by itself, not by its map, is as exact as its own float32.
    unflattened = half_sizes.max(axis=1, keepdims=True) * stretches
    return np.minimum(halves.max(axis=1), np.maximum(thicknesses, unflattened).min(axis=1))


def _find_alike_in_size(
    instance_ids: NDArray[np.int64],
    sizes: NDArray[np.float64],
    middles: NDArray[np.float64],
    halves: NDArray[np.float64],
) -> Iterator[NDArray[np.int64]]:
    """Yield groups of instances, each of which is as large as the rule wants it beside the box of its group.

    Those that are large beside all are a group. The others, if all are small, are cut in two where they are.
    """
    pending = [instance_ids]
    while pending:
        ids = pending.pop()
        if len(ids) < LEAST_COUNT:
            continue
        is_large = sizes[ids] >= _LEAST_SHARE * _half_size(ids, middles, halves)
        if is_large.any():
            yield ids[is_large]
            pending.append(ids[~is_large])
            continue
        # The box is many times larger than any of them, so they are apart; or all are flat.
        lower, upper = middles[ids].min(axis=0), middles[ids].max(axis=0)
        axis = int(np.argmax(upper / 2 - lower / 2))
        is_below = middles[ids, axis] <= lower[axis] / 2 + upper[axis] / 2
        if not is_below.all():
            pending += [ids[is_below], ids[~is_below]]


def _half_size(ids: NDArray[np.int64], middles: NDArray[np.float64], halves: NDArray[np.float64]) -> float:
    """Return half the largest side of the box around some instances."""
    lower, upper = (middles[ids] - halves[ids]).min(axis=0), (middles[ids] + halves[ids]).max(axis=0)
    return float(np.max(upper / 2 - lower / 2))


def _with_short_numbers(group: NDArray[np.int64], state: SceneState) -> NDArray[np.int64]:
    """Return the instances of a group whose primitives have numbers on the device, see `Merging`."""
    face_counts = np.array([state.shapes[geometry].prim_count for geometry in state.geometry_ids[group]])
    id_bits = int(group[-1] - group[0]).bit_length()
    return group[face_counts <= 1 << max(ALL_PRIM_BITS - id_bits, 0)]
