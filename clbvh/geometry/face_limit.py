"""The number of triangles that a mesh may have: what the formats of trees can count, and what fits the free memory."""

from __future__ import annotations

from ..errors import MeshError
from ..support.memory import free_memory_bytes
from .mesh import MAX_FACE_COUNT

# What a triangle takes while its mesh is made, and what a vertex takes in a mesh with more of them. Traced for 400,000
# triangles of each shape: up to 138 bytes.
_BYTES_PER_FACE = 150


def check_face_count(face_count: int, vertex_count: int = 0) -> None:
    """Raise `MeshError` if a mesh would be too large; for checks before arrays for it are allocated."""
    if face_count > MAX_FACE_COUNT:
        raise MeshError(f"{face_count:,} triangles are too many: the limit is {MAX_FACE_COUNT:,}")
    needed, free = max(face_count, vertex_count) * _BYTES_PER_FACE, free_memory_bytes()
    if needed > free:
        size = f"{face_count:,} triangles" + (f" and {vertex_count:,} vertices" if vertex_count else "")
        raise MeshError(f"{size} need about {needed / 1e6:,.0f} MB of memory, but {free / 1e6:,.0f} MB are free")
