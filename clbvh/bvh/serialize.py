"""A tree as one file. Its content is not trusted: a damaged or forged file is refused before its links are followed.

The file, all numbers little-endian:

    bytes   field
    8       MAGIC
    4       format version, uint32
    4       number of nodes N, uint32
    4       number of primitives F, uint32
    32      fingerprint of the mesh
    16      digest of everything behind the header
    16      digest of the header so far
    4 N     `first` of every node, int32
    4 N     `count` of every node, int32
    4 F     prim_ids, int32

The boxes are not stored. They follow from the links and the mesh, and computing them takes no longer than reading and
checking them would, so the file has 8 bytes per node instead of 32, and no box can be wrong.
"""

from __future__ import annotations

import hashlib
import os
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import TreeFileError
from ..geometry import Mesh
from ..support.compiled import compiled
from ..support.files import as_path, check_target, open_regular, read_errors_as, write_atomically
from .refit import fit_nodes

# The first byte is not text, and the line ends reveal a transfer that changed them (as in PNG).
MAGIC = b"\x8bBVH\r\n\x1a\n"
FORMAT_VERSION = 2

_DIGEST_BYTES = 16
_FACTS = struct.Struct("<8sIII32s16s")
_HEADER_BYTES = _FACTS.size + _DIGEST_BYTES
_WORD = np.dtype("<i4")


def write_tree(path: str | os.PathLike[str], nodes: NDArray[np.void], prim_ids: NDArray[np.int32], mesh: Mesh) -> None:
    """Write a tree into a file, which appears complete or not at all.

    Parameters
    ----------
    path : str or path
        A file of this name is replaced.
    nodes : (N,) `structs.NODE`
    prim_ids : (F,) int32
    mesh : Mesh
        Only its fingerprint goes into the file.

    Raises
    ------
    ConfigError
        The folder does not exist, the path is a folder, or is no path at all.
    """
    target = as_path(path)
    check_target(target)
    payload = np.concatenate([nodes["first"], nodes["count"], prim_ids]).astype(_WORD, copy=False).data
    facts = _FACTS.pack(MAGIC, FORMAT_VERSION, len(nodes), len(prim_ids), mesh.fingerprint, _digest(payload))

    def write(file: BinaryIO) -> None:
        file.write(facts)
        file.write(_digest(facts))
        file.write(payload)

    write_atomically(target, write)


def read_tree(path: str | os.PathLike[str], mesh: Mesh) -> tuple[NDArray[np.void], NDArray[np.int32]]:
    """Read a tree that `write_tree` wrote.

    Parameters
    ----------
    path : str or path
    mesh : Mesh
        The mesh that the tree was built over: the same faces and local vertices.

    Returns
    -------
    nodes : (N,) `structs.NODE`
        A valid tree over the mesh, by the rules of `validate_tree`.
    prim_ids : (F,) int32

    Raises
    ------
    TreeFileError
        The file cannot be read, is not a saved tree, has another format, belongs to another mesh, is damaged or cut
        off, or its links make no tree.

    Notes
    -----
    O(N + F), with memory for twice the result, whatever sizes the file claims.
    """
    with read_errors_as(TreeFileError, path), open_regular(Path(path)) as file:
        node_count, digest = _check_header(file, path, mesh)
        payload = np.empty(2 * node_count + mesh.face_count, _WORD)
        if file.readinto(payload.data.cast("B")) != payload.nbytes:
            raise _damaged(path)
    if _digest(payload.data) != digest:
        raise _damaged(path)

    first, count, prim_ids = np.split(payload.astype(np.int32, copy=False), [node_count, 2 * node_count])
    if not _are_links(first, count, prim_ids):
        raise TreeFileError(f"{path}: the file is whole, but its nodes make no tree: build and save the tree again")
    return fit_nodes(first, count, prim_ids, mesh), prim_ids.copy()


def _check_header(file: BinaryIO, path: str | os.PathLike[str], mesh: Mesh) -> tuple[int, bytes]:
    """Check the header and the file's size; return the number of nodes and the digest of the payload."""
    header = file.read(_HEADER_BYTES)
    if not header.startswith(MAGIC):
        raise TreeFileError(f"{path}: this is not a saved tree")
    if len(header) < _HEADER_BYTES:
        raise _damaged(path)
    facts = header[: _FACTS.size]
    _, version, node_count, prim_count, fingerprint, digest = _FACTS.unpack(facts)
    if version != FORMAT_VERSION:
        raise TreeFileError(
            f"{path}: the tree is saved in format {version}, and this version of clbvh reads format {FORMAT_VERSION}: "
            "build and save it again"
        )
    if header[_FACTS.size :] != _digest(facts):
        raise _damaged(path)
    if fingerprint != mesh.fingerprint:
        raise TreeFileError(f"{path}: the tree was built over another mesh than {mesh.name}: build it again")
    size = os.fstat(file.fileno()).st_size
    if (
        prim_count != mesh.face_count
        or not 1 <= node_count <= 2 * prim_count - 1
        or size != _HEADER_BYTES + _WORD.itemsize * (2 * node_count + prim_count)
    ):
        raise _damaged(path)
    return node_count, digest


def _damaged(path: str | os.PathLike[str]) -> TreeFileError:
    return TreeFileError(f"{path}: the file is damaged or was cut off: build and save the tree again")


def _digest(data: bytes | memoryview) -> bytes:
    return hashlib.sha256(data).digest()[:_DIGEST_BYTES]


@compiled
def _are_links(first, count, prim_ids):
    """Return whether nodes and primitives make a tree, so that links can be followed without leaving the arrays.

    Every node but the root is the child of one node before it, every slot of `prim_ids` lies in one leaf, and
    `prim_ids` is a permutation.
    """
    node_count, prim_count = len(first), len(prim_ids)
    is_child = np.zeros(node_count, np.bool_)
    in_leaf = np.zeros(prim_count, np.bool_)
    is_listed = np.zeros(prim_count, np.bool_)
    child_count, slot_count = 0, 0
    for node in range(node_count):
        begin, size = np.int64(first[node]), np.int64(count[node])
        if size == 0:
            if begin <= node or begin + 1 >= node_count or is_child[begin] or is_child[begin + 1]:
                return False
            is_child[begin] = is_child[begin + 1] = True
            child_count += 2
        else:
            if size < 0 or begin < 0 or begin + size > prim_count:
                return False
            for slot in range(begin, begin + size):
                if in_leaf[slot]:
                    return False
                in_leaf[slot] = True
            slot_count += size
    for slot in range(prim_count):
        prim = prim_ids[slot]
        if prim < 0 or prim >= prim_count or is_listed[prim]:
            return False
        is_listed[prim] = True
    return child_count == node_count - 1 and slot_count == prim_count
