"""A tree as one file. Its content is not trusted: a damaged or forged file is refused before its links are followed.

The file, all numbers little-endian:

    bytes   field
    8       MAGIC
    4       format version, uint32
    4       number of nodes N, uint32
    4       number of primitives F, uint32
    32      fingerprint of the shape
    16      digest of everything behind the header
    16      digest of the header so far
    4 N     `first` of every node, int32
    4 N     `count` of every node, int32
    4 F     prim_ids, int32

The boxes are not stored. They follow from the links and the shape, and computing them takes no longer than reading and
checking them would, so the file has 8 bytes per node instead of 32, and no box can be wrong.
"""

from __future__ import annotations

import hashlib
import os
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import TreeFileError, ValidationError
from ..geometry import Shape
from ..support.files import open_regular, read_errors_as, write_atomically
from .links import check_links
from .refit import fit_nodes

# The first byte is not text, and the line ends reveal a transfer that changed them (as in PNG).
MAGIC = b"\x8bBVH\r\n\x1a\n"
FORMAT_VERSION = 2

_DIGEST_BYTES = 16
_HEADER = struct.Struct(f"<8sIII32s{_DIGEST_BYTES}s{_DIGEST_BYTES}s")
_WORD = np.dtype("<i4")


def write_tree(
    path: str | os.PathLike[str], nodes: NDArray[np.void], prim_ids: NDArray[np.int32], shape: Shape
) -> None:
    """Write a tree into a file, which appears complete or not at all.

    Parameters
    ----------
    path : str or path
        A file of this name is replaced.
    nodes : (N,) `structs.NODE`
    prim_ids : (F,) int32
    shape : Mesh or Spheres
        Only its fingerprint goes into the file.

    Raises
    ------
    ConfigError
        The folder does not exist, the path is a folder, or is no path at all.
    """
    payload = np.concatenate([nodes["first"], nodes["count"], prim_ids]).astype(_WORD, copy=False).data
    facts = MAGIC, FORMAT_VERSION, len(nodes), len(prim_ids), shape.fingerprint, _digest(payload)
    header = _HEADER.pack(*facts, b"")[:-_DIGEST_BYTES]
    write_atomically(path, lambda file: file.writelines((header, _digest(header), payload)))


def read_tree(path: str | os.PathLike[str], shape: Shape) -> tuple[NDArray[np.void], NDArray[np.int32]]:
    """Read a tree that `write_tree` wrote.

    Parameters
    ----------
    path : str or path
    shape : Mesh or Spheres
        Shape that the tree was built over: the same faces and local vertices, or local centres and radii.

    Returns
    -------
    nodes : (N,) `structs.NODE`
        A valid tree over the shape, by the rules of `validate_tree`.
    prim_ids : (F,) int32

    Raises
    ------
    TreeFileError
        The file cannot be read, is not a saved tree, has another format, belongs to another mesh, is damaged or cut
        off, or its links make no tree.

    Notes
    -----
    O(N + F), with memory for twice the largest tree over the shape, whatever sizes the file claims.
    """
    # A tree over F primitives has at most 2 F - 1 nodes, so 5 F - 2 words. A longer file fills more, and is refused.
    payload = np.empty(5 * shape.prim_count, _WORD)
    with read_errors_as(TreeFileError, path), open_regular(Path(path)) as file:
        header, size = file.read(_HEADER.size), file.readinto(payload.data.cast("B"))
    damaged = TreeFileError(f"{path}: the file is damaged or was cut off: build and save the tree again")
    if not header.startswith(MAGIC):
        raise TreeFileError(f"{path}: this is not a saved tree")
    if len(header) < _HEADER.size:
        raise damaged
    _, version, node_count, prim_count, fingerprint, digest, header_digest = _HEADER.unpack(header)
    if version != FORMAT_VERSION:
        raise TreeFileError(
            f"{path}: the tree is saved in format {version}, and this version of clbvh reads format {FORMAT_VERSION}: "
            "build and save it again"
        )
    if header_digest != _digest(header[:-_DIGEST_BYTES]):
        raise damaged
    if fingerprint != shape.fingerprint:
        raise TreeFileError(f"{path}: the tree was built over another mesh than {shape.name}: build it again")
    word_count = 2 * node_count + prim_count
    if prim_count != shape.prim_count or node_count == 0 or size != word_count * _WORD.itemsize:
        raise damaged
    payload = payload[:word_count]
    if _digest(payload.data) != digest:
        raise damaged

    first, count, prim_ids = np.split(payload.astype(np.int32, copy=False), [node_count, 2 * node_count])
    try:
        check_links(first, count, prim_ids, prim_count)
    except ValidationError as error:
        raise TreeFileError(
            f"{path}: the file is whole, but its nodes make no tree ({error}): build and save the tree again"
        ) from error
    return fit_nodes(first, count, prim_ids, shape), prim_ids.copy()


def _digest(data: bytes | memoryview) -> bytes:
    return hashlib.sha256(data).digest()[:_DIGEST_BYTES]
