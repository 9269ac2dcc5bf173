"""Small glTF files, put together by hand: numbers are appended to one buffer, the rest is JSON."""

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Gltf:
    """A glTF document and its buffer.

    `document` may be changed freely before the file is written.
    """

    def __init__(self) -> None:
        self.buffer = b""
        self.document: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}
        self.document |= {name: [] for name in ("nodes", "meshes", "accessors", "bufferViews")}

    def add_view(self, content: bytes, **keys: Any) -> int:
        """Append bytes to the buffer; return the index of their buffer view."""
        view = {"buffer": 0, "byteOffset": len(self.buffer), "byteLength": len(content), **keys}
        self.document["bufferViews"].append(view)
        self.buffer += content
        return len(self.document["bufferViews"]) - 1

    def add_accessor(self, values: Any, dtype: str, **keys: Any) -> int:
        """Append numbers, (n,), (n, 2 to 4) or (n, 16); return the index of their accessor."""
        array = np.asarray(values)
        width = 1 if array.ndim == 1 else array.shape[1]
        view = self.add_view(array.astype(f"<{dtype}").tobytes())
        accessor = {"bufferView": view, "componentType": CODES[dtype], "count": len(array), "type": TYPES[width]}
        self.document["accessors"].append(accessor | keys)
        return len(self.document["accessors"]) - 1

    def add_mesh(self, *primitives: dict[str, Any]) -> int:
        self.document["meshes"].append({"primitives": list(primitives)})
        return len(self.document["meshes"]) - 1

    def add_node(self, *, is_root: bool = True, **keys: Any) -> int:
        self.document["nodes"].append(keys)
        number = len(self.document["nodes"]) - 1
        if is_root:
            self.document["scenes"][0]["nodes"].append(number)
        return number

    def add_part(self, vertices: Any, faces: Any = None, *, node: dict[str, Any] | None = None, **keys: Any) -> int:
        """Add a node with a mesh of one primitive; return the node's index."""
        primitive = {"attributes": {"POSITION": self.add_accessor(vertices, "f4")}, **keys}
        if faces is not None:
            primitive["indices"] = self.add_accessor(np.ravel(faces), "u2")
        return self.add_node(mesh=self.add_mesh(primitive), **(node or {}))

    def write_glb(self, path: Path) -> Path:
        """Write a GLB file."""
        document = self.document | {"buffers": [{"byteLength": len(self.buffer)}]}
        path.write_bytes(pack_glb(json.dumps(document).encode(), self.buffer))
        return path

    def write_gltf(self, path: Path, **buffer: Any) -> Path:
        """Write a glTF file with its buffer within, unless `buffer` has another `uri`."""
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.buffer).decode()
        document = self.document | {"buffers": [{"byteLength": len(self.buffer), "uri": uri} | buffer]}
        path.write_text(json.dumps(document))
        return path


def pack_glb(text: bytes, buffer: bytes | None) -> bytes:
    """Return a GLB file of a JSON text and a binary chunk."""
    chunks = [(b"JSON", text + b" " * (-len(text) % 4))]
    if buffer is not None:
        chunks.append((b"BIN\0", buffer + b"\0" * (-len(buffer) % 4)))
    body = b"".join(struct.pack("<I4s", len(content), kind) + content for kind, content in chunks)
    return struct.pack("<4sII", b"glTF", 2, len(body) + 12) + body
