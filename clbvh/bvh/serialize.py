"""A tree as one file. Nothing in such a file is trusted: a damaged or a forged one is refused, never followed.

The file, all numbers little-endian:

    bytes   what
    8       MAGIC
    4       format version, uint32
    4       number of nodes N, uint32
    4       number of primitives F, uint32
    32      fingerprint of the mesh
    16      digest of what follows this header
    16      digest of the header up to here
    4 N     `first` of every node, int32
    4 N     `count` of every node, int32
    4 F     prim_ids, int32

The boxes are not in it. They follow from the links and the mesh, and to compute them takes no longer than to read and
check them, so the file has 8 bytes a node instead of 32, and a box can never be wrong.
"""

from __future__ import annotations

import hashlib
import os
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..errors import TreeFileError
from ..geometry import Mesh
from ..whole_file import check_target, write_whole
from .refit import fit_nodes

# The first byte is no text, and the line ends show a transfer that changed them (as in PNG).
MAGIC = b"\x8bBVH\r\n\x1a\n"
FORMAT_VERSION = 1

_DIGEST_BYTES = 16
_FACTS = struct.Struct("<8sIII32s16s")
_HEADER_BYTES = _FACTS.size + _DIGEST_BYTES
_WORD = np.dtype("<i4")


def write_tree(path: str | os.PathLike[str], nodes: NDArray[np.void], prim_ids: NDArray[np.int32], mesh: Mesh) -> None:
    """Write a tree into a file, which appears there whole or not at all.

    Parameters
    ----------
    path : str or path
        A file that stands there is replaced.
    nodes : (N,) `layout.NODE`
    prim_ids : (F,) int32
    mesh : Mesh
        Only its fingerprint goes into the file.

    Raises
    ------
    ConfigError
        The folder does not exist, or the path is a folder.
    """
    target = Path(path)
    check_target(target)
    payload = np.concatenate([nodes["first"], nodes["count"], prim_ids]).astype(_WORD, copy=False).data
    facts = _FACTS.pack(MAGIC, FORMAT_VERSION, len(nodes), len(prim_ids), mesh.fingerprint, _digest(payload))

    def write(file: BinaryIO) -> None:
        file.write(facts)
        file.write(_digest(facts))
        file.write(payload)

    write_whole(target, write)


def read_tree(path: str | os.PathLike[str], mesh: Mesh) -> tuple[NDArray[np.void], NDArray[np.int32]]:
    """Read a tree that `write_tree` wrote.

    Parameters
    ----------
    path : str or path
    mesh : Mesh
        The mesh that the tree was built over: the same vertices, faces and origin.

    Returns
    -------
    nodes : (N,) `layout.NODE`
        A right tree over the mesh, by the rules of `validate_tree`.
    prim_ids : (F,) int32

    Raises
    ------
    TreeFileError
        The file cannot be read, is no saved tree, has another format, belongs to another mesh, is damaged or cut off,
        or its links make no tree.

    Notes
    -----
    O(N + F), with memory for the result and as many bytes again, whatever the file claims.
    """
    try:
        with Path(path).open("rb") as file:
            node_count, digest = _check_header(file, path, mesh)
            payload = np.empty(2 * node_count + mesh.face_count, _WORD)
            if file.readinto(payload.data.cast("B")) != payload.nbytes:
                raise _damaged(path)
    except FileNotFoundError:
        raise TreeFileError(f"{path}: no such file") from None
    except OSError as error:
        raise TreeFileError(f"{path}: the file cannot be read: {error.strerror or error}") from error
    if _digest(payload.data) != digest:
        raise _damaged(path)

    first, count, prim_ids = np.split(payload.astype(np.int32, copy=False), [node_count, 2 * node_count])
    if not _are_links(first, count, prim_ids):
        raise TreeFileError(f"{path}: the file is whole, but its nodes make no tree: build and save the tree again")
    return fit_nodes(first, count, prim_ids, mesh), prim_ids.copy()


def _check_header(file: BinaryIO, path: str | os.PathLike[str], mesh: Mesh) -> tuple[int, bytes]:
    """Check all that the header says, the file's size included; return the number of nodes and the payload's digest."""
    header = file.read(_HEADER_BYTES)
    if not header.startswith(MAGIC):
        raise TreeFileError(f"{path}: this is no file of a saved tree")
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


@njit(cache=True, nogil=True)
def _are_links(first, count, prim_ids):  # type: ignore[no-untyped-def]
    """Say whether rows and primitives make a tree, so that whoever follows the links stays inside the arrays.

    Every row but the root is the child of one row above it, every place of `prim_ids` lies in one leaf, and `prim_ids`
    is a permutation.
    """
    node_count, prim_count = len(first), len(prim_ids)
    is_child = np.zeros(node_count, np.bool_)
    in_leaf = np.zeros(prim_count, np.bool_)
    is_listed = np.zeros(prim_count, np.bool_)
    child_count, place_count = 0, 0
    for row in range(node_count):
        begin, size = np.int64(first[row]), np.int64(count[row])
        if size == 0:
            if begin <= row or begin + 1 >= node_count or is_child[begin] or is_child[begin + 1]:
                return False
            is_child[begin] = is_child[begin + 1] = True
            child_count += 2
        else:
            if size < 0 or begin < 0 or begin + size > prim_count:
                return False
            for place in range(begin, begin + size):
                if in_leaf[place]:
                    return False
                in_leaf[place] = True
            place_count += size
    for place in range(prim_count):
        prim = prim_ids[place]
        if prim < 0 or prim >= prim_count or is_listed[prim]:
            return False
        is_listed[prim] = True
    return child_count == node_count - 1 and place_count == prim_count
