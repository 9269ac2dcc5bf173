"""The looks in a glTF file: attributes of primitives, materials and textures.

Factors are linear, as in `Material`; the textures of colours are sRGB. Of a material all textures are placed as that
of its base colour, or as its first one.

Khronos Group, "glTF 2.0 Specification", 2021, section 3.9, and the extensions that are named below.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.appearance import Appearance, make_unchecked
from ..appearance.material import OPAQUE, Material, Texture, copy_with_alpha
from ..appearance.srgb import linear_to_srgb_bytes, to_bytes
from .file_mesh import Problems, spread_colours, spread_normals, spread_uvs
from .gltf_data import GltfData, get_list, get_object, get_whole
from .texture_files import decode_image, with_alpha

_REPEAT = 10497
_WRAPS = {_REPEAT: "repeat", 33071: "clamp", 33648: "mirror"}
_NEAREST = 9728
_TRANSFORM = "KHR_texture_transform"
_DEFAULT_CUTOFF = 0.5
_OPAQUE_MODE, _MASK_MODE, _BLEND_MODE = "OPAQUE", "MASK", "BLEND"
# Sources of a texture that an extension names instead; those of basisu cannot be decoded.
_OTHER_SOURCES = ("EXT_texture_webp", "MSFT_texture_dds")
_MOST_LIGHT, _MOST_SCALE = 1e12, 100.0


class Placement(NamedTuple):
    """How textures lie on a surface: the set of coordinates, and a (2, 3) matrix of them, None for none."""

    uv_set: int
    matrix: NDArray[np.float64] | None


class GltfLooks:
    """Reads the looks of primitives; see `read`. Materials, textures and images are read once."""

    def __init__(self, gltf: GltfData, problems: Problems) -> None:
        self._gltf = gltf
        self._problems = problems
        self._made: dict[Any, Any] = {}

    def read(
        self, primitive: dict[str, Any], points: NDArray[np.float64], faces: NDArray[np.integer]
    ) -> Appearance | None:
        """Return the looks of a primitive; None if it has none.

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
                material = self._once(GltfLooks._make_material, index)
                placement = self._find_placement(index)
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
                is_opaque = material is None or (
                    material.alpha_cutoff is None
                    and self._gltf.item("materials", index).get("alphaMode", _OPAQUE_MODE) == _OPAQUE_MODE
                )
                arrays["colours"] = self._read_colours(attributes["COLOR_0"], points, faces, is_opaque=is_opaque)
        if not arrays and material is None:
            return None
        return make_unchecked(**arrays, materials=() if material is None else (material,))

    def _read_colours(
        self, accessor: Any, points: NDArray[np.float64], faces: NDArray[np.integer], *, is_opaque: bool
    ) -> NDArray[np.uint8]:
        """Return the colours of corners in sRGB; in the file they are linear."""
        linear = self._read(accessor, (3, 4), points)
        colours = copy_with_alpha(linear_to_srgb_bytes(linear[:, :3]))
        if linear.shape[1] == 4 and not is_opaque:
            colours[:, 3] = to_bytes(linear[:, 3])
        return spread_colours(colours, faces)

    def _read(self, accessor: Any, widths: tuple[int, ...], points: NDArray[np.float64]) -> NDArray[np.floating]:
        values = self._gltf.read_vectors(accessor, widths)
        if len(values) != len(points):
            raise MeshError(f"there are {len(values):,} for {len(points):,} vertices")
        return values

    def _once(self, make: Callable[..., Any], *arguments: Any) -> Any:
        """Return what a method makes of arguments; it is called once for them."""
        if (make, arguments) not in self._made:
            self._made[make, arguments] = make(self, *arguments)
        return self._made[make, arguments]

    def _find_placement(self, index: Any) -> Placement:
        """Return how the textures of a material lie."""
        infos = _list_texture_infos(self._gltf.item("materials", index))
        placements = [_read_placement(info) for info in infos if isinstance(info, dict)]
        if not placements:
            return Placement(0, None)
        keys = {(uv_set, None if matrix is None else matrix.tobytes()) for uv_set, matrix in placements}
        if len(keys) > 1:
            self._problems.add(f"the textures of materials[{index}] lie differently: all are placed as the first one")
        return placements[0]

    def _make_material(self, index: Any) -> Material:
        table = self._gltf.item("materials", index)
        pbr, extensions = get_object(table, "pbrMetallicRoughness"), get_object(table, "extensions")
        factor = _read_numbers(pbr, "baseColorFactor", (1.0, 1.0, 1.0, 1.0))
        metallic, roughness = _read_number(pbr, "metallicFactor", 1.0), _read_number(pbr, "roughnessFactor", 1.0)
        base_info, metal_info, light_info, normal_info = _list_texture_infos(table)
        if old := get_object(extensions, _OLD):
            factor = _read_numbers(old, "diffuseFactor", (1.0, 1.0, 1.0, 1.0))
            metallic, roughness = 0.0, 1 - _read_number(old, "glossinessFactor", 1.0)
        mode = table.get("alphaMode", _OPAQUE_MODE)
        if mode not in (_OPAQUE_MODE, _MASK_MODE, _BLEND_MODE):
            mode = _OPAQUE_MODE
        cutoff = max(0.0, _read_number(table, "alphaCutoff", _DEFAULT_CUTOFF)) if mode == _MASK_MODE else None
        strength = _read_number(get_object(extensions, "KHR_materials_emissive_strength"), "emissiveStrength", 1.0)
        emission = [
            min(_MOST_LIGHT, max(0.0, light * strength)) for light in _read_numbers(table, "emissiveFactor", (0.0,) * 3)
        ]
        name = table.get("name")
        normal_scale = _read_number(normal_info, "scale", 1.0) if isinstance(normal_info, dict) else 1.0
        return Material(
            name=name if isinstance(name, str) else "",
            base_colour=(factor[0], factor[1], factor[2]),
            alpha=1.0 if mode == _OPAQUE_MODE else factor[3],
            alpha_cutoff=cutoff,
            metallic=metallic,
            roughness=roughness,
            emission=(emission[0], emission[1], emission[2]),
            ior=max(1.0, _read_number(get_object(extensions, "KHR_materials_ior"), "ior", 1.5)),
            transmission=_read_number(get_object(extensions, "KHR_materials_transmission"), "transmissionFactor", 0.0),
            base_colour_texture=self._read_texture(base_info, is_srgb=True, is_opaque=mode == _OPAQUE_MODE),
            metallic_roughness_texture=self._read_texture(metal_info, is_srgb=False),
            emission_texture=self._read_texture(light_info, is_srgb=True),
            normal_texture=self._read_texture(normal_info, is_srgb=False),
            normal_scale=min(_MOST_SCALE, max(-_MOST_SCALE, normal_scale)),
        )

    def _read_texture(self, info: Any, *, is_srgb: bool, is_opaque: bool = True) -> Texture | None:
        """Return the texture that a material refers to; None if there is none, or if it cannot be used."""
        if info is None:
            return None
        with self._problems.drop("a texture"):
            if not isinstance(info, dict):
                raise MeshError("its place in the material is no object")
            table = self._gltf.item("textures", info.get("index"))
            sampler: dict[str, Any] = self._gltf.item("samplers", table["sampler"]) if "sampler" in table else {}
            wrap_u, wrap_v = (_WRAPS.get(sampler.get(key, _REPEAT), "repeat") for key in ("wrapS", "wrapT"))
            # `minFilter` is for textures that shrink: there the samples of a pixel are its filter.
            sampling = (wrap_u, wrap_v), "nearest" if sampler.get("magFilter") == _NEAREST else "linear"
            return self._once(GltfLooks._make_texture, _find_source(table), sampling, is_srgb, is_opaque)
        return None

    def _make_texture(
        self, image: Any, sampling: tuple[tuple[str, str], str], is_srgb: bool, is_opaque: bool
    ) -> Texture:
        table = self._gltf.item("images", image)
        uri = str(table.get("uri", ""))
        name = table.get("name") or (uri if uri and not uri.startswith("data:") else f"images[{image}]")
        texture = Texture(str(name), self._once(GltfLooks._decode_image, image), is_srgb, *sampling)
        return with_alpha(texture, OPAQUE) if is_opaque else texture

    def _decode_image(self, image: Any) -> NDArray[np.uint8]:
        table = self._gltf.item("images", image)
        if "bufferView" in table:
            return decode_image(self._gltf.read_view_bytes(table["bufferView"]))
        uri = table.get("uri")
        if not isinstance(uri, str):
            raise MeshError(f"images[{image}] has neither a buffer view nor a uri")
        return decode_image(self._gltf.read_uri(uri, f"images[{image}]", may_be_above=True))


_OLD = "KHR_materials_pbrSpecularGlossiness"
_PBR_TEXTURES = ("baseColor", "metallicRoughness")


def _list_texture_infos(material: dict[str, Any]) -> list[Any]:
    """Return the places of textures in a material: of base colour, metal and roughness, light, and normals."""
    pbr, old = get_object(material, "pbrMetallicRoughness"), get_object(get_object(material, "extensions"), _OLD)
    of_base = [old.get("diffuseTexture"), None] if old else [pbr.get(f"{name}Texture") for name in _PBR_TEXTURES]
    return [*of_base, material.get("emissiveTexture"), material.get("normalTexture")]


def _read_placement(info: dict[str, Any]) -> Placement:
    transform = get_object(get_object(info, "extensions"), _TRANSFORM)
    uv_set = get_whole(transform if "texCoord" in transform else info, "texCoord", 0)
    if not transform.keys() & {"offset", "rotation", "scale"}:
        return Placement(uv_set, None)
    x, y = _read_numbers(transform, "offset", (0.0, 0.0))
    width, height = _read_numbers(transform, "scale", (1.0, 1.0))
    angle = _read_number(transform, "rotation", 0.0)
    # By the text of the extension: translation * rotation * scale, with v downwards.
    cosine, sine = math.cos(angle), math.sin(angle)
    return Placement(uv_set, np.array([[cosine * width, sine * height, x], [-sine * width, cosine * height, y]]))


def _find_source(texture: dict[str, Any]) -> Any:
    """Return the index of a texture's image."""
    extensions = get_object(texture, "extensions")
    for name in _OTHER_SOURCES:
        if name in extensions:
            return get_object(extensions, name).get("source")
    if "source" not in texture:
        raise MeshError(f"it has no image that is read{', but ' + ', '.join(extensions) if extensions else ''}")
    return texture["source"]


def _read_number(table: dict[str, Any], key: str, default: float) -> float:
    return _read_numbers({key: [table.get(key, default)]}, key, (default,))[0]


def _read_numbers(table: dict[str, Any], key: str, default: tuple[float, ...]) -> list[float]:
    """Return as many finite numbers as the default has; factors are limited to their range, 0 to 1."""
    values = get_list(table, key) if key in table else default
    if [type(value) for value in values if type(value) not in (int, float)] or len(values) != len(default):
        raise MeshError(f"'{key}' must be {len(default)} numbers, not {str(values)[:40]}")
    if not all(abs(value) <= sys.float_info.max for value in values):
        raise MeshError(f"'{key}' is not finite")
    return [min(1.0, max(0.0, float(value))) if key.endswith("Factor") else float(value) for value in values]
