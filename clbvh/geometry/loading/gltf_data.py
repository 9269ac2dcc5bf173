"""The data of a glTF file: the container, its buffers, and the numbers that accessors describe.

Owns everything between the bytes of the file and arrays of numbers. No array is larger than the bytes that the file
really has for it. Must not know of nodes, meshes or triangles.

Khronos Group, "glTF 2.0 Specification", 2021: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import base64
import binascii
import json
import re
import struct
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from .file_mesh import read_named
from .texture_files import find_file

_GLB_MAGIC = b"glTF"
_GLB_HEADER = struct.Struct("<4sII")  # magic, version, length of the file
_CHUNK_HEADER = struct.Struct("<I4s")  # length of the content, type
_VERSION = 2
_DATA_URI = re.compile(r"data:[^,]*?(;base64)?,", re.IGNORECASE)
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")

_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_UNSIGNED = (5121, 5123, 5125)
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

# Their bytes are compressed; a copy that is not is allowed beside them, and is read if it is there.
_COMPRESSED_VIEWS = ("EXT_meshopt_compression", "KHR_meshopt_compression")


class GltfData:
    """The JSON text of a glTF file, and the arrays that its accessors describe.

    Parameters
    ----------
    data : bytes
        A GLB file or the text of a glTF file.
    file : Path
        Its place, where the files of its buffers are found.

    Raises
    ------
    MeshError
        The container is cut off, damaged, or of another version.
    """

    def __init__(self, data: bytes, file: Path) -> None:
        text, self._chunk = _split_glb(data) if data.startswith(_GLB_MAGIC) else (data, None)
        self._folder = file.parent
        self._buffers: dict[int, bytes] = {}
        # An accessor without a buffer view is all zeros, of which the file holds none.
        self._max_zeros = len(data)
        try:
            self.document: dict[str, Any] = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise MeshError(f"the file is cut off or damaged: its JSON text cannot be read: {error}") from error
        if not isinstance(self.document, dict):
            raise MeshError("the JSON text of the file is no glTF: it must be one object")
        version = str(get_object(self.document, "asset").get("version", _VERSION))
        if version.partition(".")[0] != str(_VERSION):
            raise MeshError(f"the file is glTF {version[:20]}, but glTF {_VERSION} is read")

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """Return one object of a list of the document, such as ``item("nodes", 3)``."""
        items = get_list(self.document, kind)
        if not _is_whole(index) or not 0 <= index < len(items):
            raise MeshError(f"the file refers to {kind}[{index!r}], but has {len(items)} {kind}")
        if not isinstance(items[index], dict):
            raise MeshError(f"{kind}[{index}] must be an object, not {str(items[index])[:20]!r}")
        return items[index]

    def count_items(self, index: Any) -> int:
        """Return the number of items of an accessor, after a look at whether the file has the bytes for them."""
        return len(self._find_numbers(index))

    def read_vectors(self, index: Any, widths: tuple[int, ...]) -> NDArray[np.float64]:
        """Return the vectors of an accessor, (n, width); whole numbers that stand for fractions are divided.

        Raises
        ------
        MeshError
            Also if the width is none of those that are given.
        """
        numbers = self._read_numbers(index)
        if numbers.shape[1] not in widths:
            raise MeshError(f"accessors[{index}] has vectors of {numbers.shape[1]} numbers, not {widths[0]}")
        if not self.item("accessors", index).get("normalized") or numbers.dtype.kind == "f":
            with np.errstate(invalid="ignore"):  # a signalling NaN
                return numbers.astype(np.float64)
        # The smallest signed number would be a little less than -1.
        return np.maximum(numbers / np.iinfo(numbers.dtype).max, -1)

    def read_indices(self, index: Any) -> NDArray[np.int64]:
        """Return the vertex indices of an accessor, (n,)."""
        accessor = self.item("accessors", index)
        if accessor.get("type") != "SCALAR" or accessor.get("componentType") not in _UNSIGNED:
            raise MeshError(f"accessors[{index}] has vertex indices, so it must be SCALAR and of an unsigned type")
        return self._read_numbers(index)[:, 0].astype(np.int64)

    def has_data(self, index: Any) -> bool:
        """Return whether the file has bytes for an accessor, or for some of its items."""
        accessor = self.item("accessors", index)
        return "bufferView" in accessor or "sparse" in accessor

    def read_view_bytes(self, index: Any) -> bytes:
        """Return the bytes of a buffer view."""
        length = get_whole(self.item("bufferViews", index), "byteLength")
        return self._read_view(index, 0, np.dtype(np.uint8), length, 1, f"bufferViews[{index}]").tobytes()

    def read_uri(self, uri: str, where: str, *, may_be_above: bool = False) -> bytes:
        """Return the bytes that a URI holds or names: those of a file in the folder of the glTF file, or below it."""
        if found := _DATA_URI.match(uri):
            try:
                content = unquote_to_bytes(uri[found.end() :])
                return base64.b64decode(content, validate=True) if found[1] else content
            except binascii.Error as error:
                raise MeshError(f"{where} has a uri that is not base64: {error}") from error
        path = PurePosixPath(unquote(uri).replace("\\", "/"))
        if _SCHEME.match(uri) or (not may_be_above and (path.is_absolute() or ".." in path.parts)):
            below = "" if may_be_above else "in the folder of the glTF file or below it "
            raise MeshError(f"{where} is '{uri[:80]}', but only files {below}are read")
        return read_named(find_file(self._folder, unquote(uri)) if may_be_above else self._folder / path)

    def _find_numbers(self, index: Any) -> NDArray[Any]:
        """Return the numbers of an accessor as they lie in the buffer, (n, width), without those of `sparse`."""
        accessor, where = self.item("accessors", index), f"accessors[{index}]"
        width, count = _WIDTHS.get(str(accessor.get("type"))), get_whole(accessor, "count")
        if width is None:
            raise MeshError(f"{where} must have one of the types {', '.join(_WIDTHS)}")
        dtype = _find_dtype(accessor.get("componentType"), where)
        if "bufferView" in accessor:
            offset = get_whole(accessor, "byteOffset", 0)
            return self._read_view(accessor["bufferView"], offset, dtype, count, width, where)
        if count > self._max_zeros:
            raise MeshError(f"{where} declares {count:,} items, for which the file has no bytes")
        return np.broadcast_to(np.zeros(1, dtype), (count, width))

    def _read_numbers(self, index: Any) -> NDArray[Any]:
        """Return the numbers of an accessor, (n, width), in the file's own type."""
        accessor, numbers = self.item("accessors", index), self._find_numbers(index)
        if "sparse" in accessor:
            return self._replace(numbers.copy(), get_object(accessor, "sparse"), f"accessors[{index}]")
        return numbers

    def _replace(self, numbers: NDArray[Any], sparse: dict[str, Any], where: str) -> NDArray[Any]:
        """Overwrite the items that a sparse accessor lists."""
        count, (ids_at, values_at) = get_whole(sparse, "count"), (get_object(sparse, k) for k in ("indices", "values"))
        ids_dtype = _find_dtype(ids_at.get("componentType"), f"{where}.sparse.indices")
        ids_view, ids_offset = ids_at.get("bufferView"), get_whole(ids_at, "byteOffset", 0)
        ids = self._read_view(ids_view, ids_offset, ids_dtype, count, 1, f"{where}.sparse.indices")[:, 0]
        if len(ids) and not 0 <= ids.min() <= ids.max() < len(numbers):
            raise MeshError(f"{where}.sparse refers to an item beyond the {len(numbers)} of its accessor")
        view, offset = values_at.get("bufferView"), get_whole(values_at, "byteOffset", 0)
        numbers[ids] = self._read_view(view, offset, numbers.dtype, count, numbers.shape[1], f"{where}.sparse.values")
        return numbers

    def _read_view(
        self, view_index: Any, offset: int, dtype: np.dtype, count: int, width: int, where: str
    ) -> NDArray[Any]:
        """Return (count, width) numbers that begin `offset` bytes into a buffer view, which may interleave them."""
        view = self.item("bufferViews", view_index)
        begin, length = get_whole(view, "byteOffset", 0), get_whole(view, "byteLength")
        buffer = self._read_buffer(view, view_index)
        if begin + length > len(buffer):
            raise MeshError(
                f"bufferViews[{view_index}] ends at byte {begin + length:,}, but its buffer has {len(buffer):,} bytes"
            )
        size = width * dtype.itemsize
        stride = get_whole(view, "byteStride", size)
        if stride < size:
            raise MeshError(f"bufferViews[{view_index}] has items of {size} bytes, but a byteStride of {stride}")
        end = offset + stride * (count - 1) + size if count else 0
        if end > length:
            raise MeshError(
                f"{where} ends at byte {end:,} of bufferViews[{view_index}], which has {length:,} bytes: "
                "the file is damaged or incomplete"
            )
        return np.ndarray((count, width), dtype, buffer, begin + offset if count else 0, (stride, dtype.itemsize))

    def _read_buffer(self, view: dict[str, Any], view_index: Any) -> bytes:
        """Return the buffer of a view, from the GLB file itself or from its URI; it is read only once."""
        index: Any = view.get("buffer")
        buffer = self.item("buffers", index)
        uri, chunk = buffer.get("uri"), self._chunk if index == 0 else None
        has_bytes = "uri" in buffer or chunk is not None
        for name in _COMPRESSED_VIEWS:
            if name in get_object(view, "extensions") and not has_bytes:
                raise refuse_compression(name)
        if index not in self._buffers:
            length = get_whole(buffer, "byteLength")
            if not isinstance(uri, str | None):
                raise MeshError(f"buffers[{index}] has a uri that is no text")
            content = chunk if uri is None else self.read_uri(uri, f"buffers[{index}]")
            if content is None:
                raise MeshError(f"buffers[{index}] has no uri, so its bytes are missing")
            if len(content) < length:
                raise MeshError(
                    f"buffers[{index}] declares {length:,} bytes, but has {len(content):,}: "
                    "the file is damaged or incomplete"
                )
            self._buffers[index] = content[:length]
        return self._buffers[index]


_DECODE = "write the file without compression (for example: gltf-transform copy IN OUT)"


def refuse_compression(name: str) -> MeshError:
    """Return the error for an extension that compresses vertices."""
    return MeshError(f"the file is compressed by {name}, which is not read: {_DECODE}")


def get_whole(table: dict[str, Any], key: str, default: int | None = None) -> int:
    """Return a whole number from 0 of a JSON object."""
    value: Any = table.get(key, default)
    if not _is_whole(value) or value < 0:
        raise MeshError(f"'{key}' must be a whole number from 0, not {str(value)[:20]!r}")
    return value


def get_object(table: dict[str, Any], key: str) -> dict[str, Any]:
    """Return a JSON object of another one; empty if it is missing."""
    return _get(table, key, {}, "an object")


def get_list(table: dict[str, Any], key: str) -> list[Any]:
    """Return a list of a JSON object; empty if it is missing."""
    return _get(table, key, [], "a list")


def _get(table: dict[str, Any], key: str, default: Any, kind: str) -> Any:
    value = table.get(key, default)
    if not isinstance(value, type(default)):
        raise MeshError(f"'{key}' must be {kind}, not {str(value)[:20]!r}")
    return value


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _find_dtype(code: Any, where: str) -> np.dtype:
    if not isinstance(code, int) or code not in _DTYPES:
        raise MeshError(f"{where} has the componentType {str(code)[:20]}, but glTF has {', '.join(map(str, _DTYPES))}")
    return np.dtype(_DTYPES[code])


def _split_glb(data: bytes) -> tuple[bytes, bytes | None]:
    """Return the JSON text and the binary chunk, if there is one, of a GLB file."""
    if len(data) < _GLB_HEADER.size:
        raise MeshError("the file is cut off or damaged: it has no whole GLB header")
    _, version, length = _GLB_HEADER.unpack_from(data)
    if version != _VERSION:
        raise MeshError(f"the file is GLB {version}, but GLB {_VERSION} is read")
    if length != len(data):
        raise MeshError(f"the file is cut off or damaged: it declares {length:,} bytes, but has {len(data):,}")
    chunks: list[tuple[bytes, bytes]] = []
    at = _GLB_HEADER.size
    while at < len(data):
        if at + _CHUNK_HEADER.size > len(data):
            raise MeshError("the file is cut off or damaged: it ends within the header of a chunk")
        size, kind = _CHUNK_HEADER.unpack_from(data, at)
        at += _CHUNK_HEADER.size
        if at + size > len(data):
            raise MeshError(
                f"the file is cut off or damaged: a chunk declares {size:,} bytes, but {len(data) - at:,} follow"
            )
        chunks.append((kind, data[at : at + size]))
        at += size
    if not chunks or chunks[0][0] != b"JSON":
        raise MeshError("the file is damaged: its first chunk is not JSON")
    # By the specification the second chunk is the binary one; later chunks are for extensions.
    return chunks[0][1], next((content for kind, content in chunks[1:2] if kind == b"BIN\0"), None)
