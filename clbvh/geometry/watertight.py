"""Whether triangles enclose a volume: every edge belongs to an even number of them.

Each edge is hashed to 128 bits, and the exclusive or of all hashes is taken: edges that occur an even number of times
cancel. So the test takes one pass and no sorting; the chance of two edges with equal hashes is negligible.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Faces processed at a time, so that the temporary arrays stay in the processor's cache.
_CHUNK_FACES = 1 << 14

# One start value for each half of the 128 bits, from the binary digits of pi and of e.
_SEEDS = (0x243F6A8885A308D3, 0xADF85458A2BB4A9A)


def is_closed(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> bool:
    """Return whether every edge belongs to an even number of triangles.

    Parameters
    ----------
    vertices : (V, 3) float32
        Vertices at one point count as one: a file may list them once for each triangle.
    faces : (F, 3) int32
    """
    return all(_do_edges_cancel(_hash_points(vertices, np.uint64(seed)), faces) for seed in _SEEDS)


def is_joined(vertex_count: int, faces: NDArray[np.int32]) -> bool:
    """Return whether every edge between two vertex indices belongs to an even number of triangles.

    A mesh of such faces is closed wherever its vertices are.

    Parameters
    ----------
    vertex_count : int
    faces : (F, 3) int32
    """
    indices = np.arange(vertex_count, dtype=np.uint64)
    return all(_do_edges_cancel(_mix(_mix(indices) ^ np.uint64(seed)), faces) for seed in _SEEDS)


def _do_edges_cancel(point_hashes: NDArray[np.uint64], faces: NDArray[np.int32]) -> bool:
    """Return whether the exclusive or of the hashes of all edges is zero."""
    total = np.uint64(0)
    for begin in range(0, len(faces), _CHUNK_FACES):
        total ^= _hash_edges(point_hashes[faces[begin : begin + _CHUNK_FACES]])
    return bool(total == 0)


def _hash_points(points: NDArray[np.float32], seed: np.uint64) -> NDArray[np.uint64]:
    """Return (V,) hashes, equal for points with equal coordinates."""
    bits = (points + np.float32(0)).view(np.uint32).astype(np.uint64)  # the sum turns -0 into 0
    hashes = np.full(len(points), seed)
    for axis in range(3):
        hashes = _mix(hashes ^ bits[:, axis])
    return hashes


def _hash_edges(corners: NDArray[np.uint64]) -> np.uint64:
    """Return the exclusive or of the hashes of the triangles' edges, which have no direction and no zero length."""
    total = np.uint64(0)
    for corner in range(3):
        one, other = corners[:, corner], corners[:, (corner + 1) % 3]
        hashes = _mix(one + other)
        total ^= np.bitwise_xor.reduce(hashes[one != other], initial=0)
    return total


def _mix(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return a bijective hash of 64-bit values (finalizer of SplitMix64; Steele, Lea and Flood, 2014)."""
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))
