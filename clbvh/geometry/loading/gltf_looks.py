"""The looks of a primitive of a glTF file: its attributes at the corners of triangles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.srgb import linear_to_srgb_bytes, to_bytes
from .corner_values import spread_colours, spread_normals, spread_uvs
from .gltf_data import GltfData, get_object
from .gltf_materials import GltfMaterials
from .joined_looks import LooksPiece
from .problems import Problems

_OPAQUE = 255


class GltfLooks:
    """Reads the looks of primitives; see `read`."""

    def __init__(self, gltf: GltfData, problems: Problems) -> None:
        self._gltf = gltf
        self._problems = problems
        self._materials = GltfMaterials(gltf, problems)

    def read(self, primitive: dict[str, Any], points: NDArray[np.float64], faces: NDArray[np.integer]) -> LooksPiece:
        """Return the looks of a primitive.

        Parameters
        ----------
        primitive : dict
            The object of the document.
        points, faces : (V, 3) float64 and (F, 3) int
            Its triangles.
        """
        arrays: dict[str, NDArray] = {}
        attributes = get_object(primitive, "attributes")
        material, placement = None, None
        if (index := primitive.get("material")) is not None:
            with self._problems.drop("a material"):
                material = self._materials.read(index)
                placement = self._materials.placement_of(index)
        if "NORMAL" in attributes:
            with self._problems.drop("the normals"):
                arrays["normals"] = spread_normals(self._read(attributes["NORMAL"], (3,), points), faces, points, faces)
        name = f"TEXCOORD_{0 if placement is None else placement.uv_set}"
        if name in attributes:
            with self._problems.drop("the texture coordinates"):
                uvs = self._read(attributes[name], (2,), points)
                if placement is not None and placement.matrix is not None:
                    uvs = uvs @ placement.matrix[:, :2].T + placement.matrix[:, 2]
                # Theirs count from the top.
                arrays["uvs"] = spread_uvs(np.column_stack((uvs[:, 0], 1 - uvs[:, 1])), faces)
        if "COLOR_0" in attributes:
            with self._problems.drop("the colours"):
                is_opaque = material is None or (material.alpha_cutoff is None and self._materials.is_opaque(index))
                arrays["colours"] = self._read_colours(attributes["COLOR_0"], points, faces, is_opaque=is_opaque)
        return LooksPiece(arrays, material, points, faces)

    def _read_colours(
        self, accessor: Any, points: NDArray[np.float64], faces: NDArray[np.integer], *, is_opaque: bool
    ) -> NDArray[np.uint8]:
        """Return the colours of corners in sRGB; in the file they are linear."""
        linear = self._read(accessor, (3, 4), points)
        colours = np.full((len(linear), 4), _OPAQUE, np.uint8)
        colours[:, :3] = linear_to_srgb_bytes(linear[:, :3])
        if linear.shape[1] == 4 and not is_opaque:
            colours[:, 3] = to_bytes(linear[:, 3])
        return spread_colours(colours, faces)

    def _read(self, accessor: Any, widths: tuple[int, ...], points: NDArray[np.float64]) -> NDArray[np.floating]:
        values = self._gltf.read_vectors(accessor, widths)
        if len(values) != len(points):
            raise MeshError(f"there are {len(values):,} for {len(points):,} vertices")
        return values
