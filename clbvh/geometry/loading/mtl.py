"""The MTL format: the materials of OBJ files.

Colours are taken to be sRGB, as programs write what their colour pickers show, but for light (`Ke`), which may be above
1 and is linear. `Ns` is the exponent of Blinn's highlight, n = 2 / a^2 - 2 for the width a of a microfacet
distribution, which is the square of the roughness (Bruce Walter et al., "Microfacet Models for Refraction through Rough
Surfaces", 2007).

Wavefront Technologies, "MTL material format", 1995; Ben Houston and others, "Extending the Wavefront MTL format for
physically-based rendering", 2014.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import MeshError
from ..appearance.material import OPAQUE, Material, Texture
from ..appearance.srgb import srgb_to_linear
from .file_mesh import Problems, decode_text, read_named
from .texture_files import TextureFiles, find_file, with_alpha

_MAX_BYTES = 1 << 26
_NEW = b"newmtl"
_BUMP_KEYS = (b"map_bump", b"bump")
_TEXTURE_KEYS = (b"map_kd", b"map_d", b"map_ke", b"norm")
# An option of a texture, with its numbers or its word; the rest of the line is the name of a file.
_NUMBER = rb"\s+[-+]?(?:\d++\.?\d*+|\.\d++)(?:e[-+]?\d++)?(?=\s)"
_OPTION = re.compile(
    rb"(?i)-(?:[sot](?:%s){1,3}|mm(?:%s){1,2}|(?:bm|boost|texres)%s|(?:blendu|blendv|cc|clamp|imfchan|type)\s+\S+)\s+"
    % (_NUMBER, _NUMBER, _NUMBER)
)
# Options without effect, or with what is done anyway. Zeros behind the point of a number are cut off first.
_NEUTRAL = re.compile(rb"-(blend[uv] on|cc off|imfchan [lm]|texres .*|bm 1|boost 0|t 0( 0)*|mm 0( 1)?)")
_MOST_PLACEMENT = 1e6  # as far as textures are repeated
_ZEROS = re.compile(rb"\.0*(?= |$)")
_REFRACTION, _GLASS = (6, 7), (4, 9)  # values of `illum`
# A surface that is darker than this and reflects more than that is a metal, if nothing else says so.
_DARK, _BRIGHT = 0.04, 0.3

_Words = dict[bytes, list[bytes]]


# Scale and offset of texture coordinates: u, v, u, v.
Placement = tuple[float, float, float, float]
PLAIN: Placement = (1.0, 1.0, 0.0, 0.0)


class MtlMaterial(NamedTuple):
    """A material, and how its textures lie."""

    material: Material
    placement: Placement


class _Map(NamedTuple):
    """A statement such as ``map_Kd -s 2 2 1 -clamp on wood.png``; `unused` are the options that are not followed."""

    name: str
    placement: Placement
    wrap: str
    bump: float
    unused: tuple[str, ...]


def read_materials(names: bytes, folder: Path, textures: TextureFiles, problems: Problems) -> dict[bytes, MtlMaterial]:
    """Return the materials of the files that an `mtllib` statement names, by name.

    Parameters
    ----------
    names : bytes
        One name with spaces, or several names.
    folder : Path
        Of the OBJ file.
    textures : TextureFiles
    problems : Problems
        Files that cannot be read, and materials that cannot be used, go there.
    """
    whole = names.decode("utf-8", "replace")
    files = [whole] if find_file(folder, whole).is_file() else whole.split()
    materials: dict[bytes, MtlMaterial] = {}
    for name in files:
        path = find_file(folder, name)
        statements: dict[bytes, _Words] = {}
        with problems.drop(f"the materials {path.name}"):
            statements = _split(read_named(path, max_bytes=_MAX_BYTES))
        for key, words in statements.items():
            label = key.decode("utf-8", "replace")[:40]
            with problems.drop(f"the material '{label}'"):
                maps = {kind: _read_map(kind, words[kind][0]) for kind in _TEXTURE_KEYS if any(words.get(kind, ()))}
                materials.setdefault(key, _make_material(key, words, maps, textures, path.parent))
                if len({each.placement for each in maps.values()}) > 1:
                    problems.add(f"the textures of '{label}' lie differently: all are placed as the first one")
                for kind, each in maps.items():
                    for option in each.unused:
                        problems.add(f"the option {option} of {kind.decode()} in {path} is not used")
            if any(words.get(bump) for bump in _BUMP_KEYS):
                problems.add(f"the heights of map_Bump in {path} are not drawn; norm is")
    return materials


def _split(data: bytes) -> dict[bytes, _Words]:
    """Return the statements of each material: the words behind each keyword, in small letters."""
    materials: dict[bytes, _Words] = {}
    words: _Words = {}
    for line in decode_text(data).splitlines():
        keyword, *rest = line.split(None, 1)[:2] or [b""]
        value = rest[0].strip() if rest else b""
        if keyword.lower() == _NEW:
            words = materials.setdefault(value, {})
        elif keyword and not keyword.startswith(b"#"):
            is_name = keyword.lower() in _TEXTURE_KEYS + _BUMP_KEYS
            words[keyword.lower()] = [value] if is_name else value.partition(b"#")[0].split()
    return materials


def _read_map(kind: bytes, value: bytes) -> _Map:
    """Return the statement of a texture, of what stands behind its keyword."""
    options: dict[bytes, list[bytes]] = {}
    at = 0
    while option := _OPTION.match(value, at):
        key, *words = option[0].lower().split()
        options[key] = words
        at = option.end()
    # Of three numbers the last one is for textures in space.
    placement = tuple(
        number
        for key, default in ((b"-s", 1.0), (b"-o", 0.0))
        for number in (*map(float, options.pop(key, ())), default, default)[:2]
    )
    bump = float(options.pop(b"-bm", [b"1"])[0]) if kind == b"norm" else 1.0
    if max(map(abs, placement)) > _MOST_PLACEMENT:
        raise MeshError(f"an option of {kind.decode()} is more than {_MOST_PLACEMENT:,.0f}")
    wrap = "clamp" if options.pop(b"-clamp", []) == [b"on"] else "repeat"
    unused = [key.decode() for key, words in options.items() if not _is_neutral(key, words)]
    return _Map(value[at:].decode("utf-8", "replace"), placement, wrap, bump, tuple(unused))  # type: ignore[arg-type]


def _is_neutral(key: bytes, words: list[bytes]) -> bool:
    return _NEUTRAL.fullmatch(_ZEROS.sub(b"", b" ".join([key, *words]))) is not None


def _make_material(
    name: bytes, words: _Words, maps: dict[bytes, _Map], textures: TextureFiles, folder: Path
) -> MtlMaterial:
    """Return a material of its statements."""

    def read(kind: bytes, *, is_srgb: bool) -> Texture | None:
        if kind not in maps:
            return None
        each = maps[kind]
        return textures.read(each.name, is_srgb=is_srgb, wrap=(each.wrap, each.wrap), folder=folder)

    diffuse = _read_colour(words, b"kd")
    specular = _read_colour(words, b"ks")
    base = tuple(srgb_to_linear(diffuse)) if diffuse is not None else Material.base_colour
    alpha = _read_number(words, b"d", 1 - _read_number(words, b"tr", 0))
    illumination = int(_read_number(words, b"illum", 2))
    metallic, roughness = _read_number(words, b"pm", 0), _find_roughness(words, specular)
    is_dark = diffuse is not None and max(diffuse) <= _DARK
    texture = read(b"map_kd", is_srgb=True)
    if is_dark and texture is not None:
        base = (1.0, 1.0, 1.0)  # written by programs that ignore the colour beside a texture
    elif is_dark and b"pm" not in words and specular is not None and max(specular) >= _BRIGHT:
        base, metallic = tuple(srgb_to_linear(specular)), 1.0

    transmission = 0.0
    if illumination in _REFRACTION or (illumination in _GLASS and alpha < 1):
        filtered = _read_colour(words, b"tf")
        base = tuple(filtered) if filtered is not None and max(filtered) > 0 else (1.0, 1.0, 1.0)
        transmission, alpha, metallic = 1.0, 1.0, 0.0
    elif alpha == 0 and b"map_d" not in words:
        alpha = 1.0  # written by programs that mean opaque: nobody models what is not there

    mask = read(b"map_d", is_srgb=False)
    light = read(b"map_ke", is_srgb=True)
    red, green, blue = (max(0.0, number) for number in _read_numbers(words.get(b"ke", [b"0"])))
    if light is not None and red == green == blue == 0:
        red = green = blue = 1.0
    material = Material(
        name=name.decode("utf-8", "replace"),
        base_colour=(float(base[0]), float(base[1]), float(base[2])),
        alpha=_limit(alpha),
        metallic=_limit(metallic),
        roughness=_limit(roughness),
        emission=(red, green, blue),
        ior=max(1.0, _read_number(words, b"ni", 1.5)),
        transmission=transmission,
        base_colour_texture=_join_alpha(texture, mask),
        emission_texture=light,
        normal_texture=read(b"norm", is_srgb=False),
        normal_scale=maps[b"norm"].bump if b"norm" in maps else 1.0,
    )
    return MtlMaterial(material, next(iter(maps.values())).placement if maps else PLAIN)


def _find_roughness(words: _Words, specular: list[float] | None) -> float:
    if b"pr" in words:
        return _read_number(words, b"pr", Material.roughness)
    if specular is not None and max(specular) == 0:
        return 1.0  # no highlight
    if b"ns" in words:
        return (2 / (max(0.0, _read_number(words, b"ns", 0)) + 2)) ** 0.25
    return Material.roughness


def _read_colour(words: _Words, key: bytes) -> list[float] | None:
    """Return a colour from 0 to 1; None if it is not there, or is none of three numbers."""
    if key not in words or words[key][:1] in ([b"spectral"], [b"xyz"]):
        return None
    return [_limit(number) for number in _read_numbers(words[key])]


def _read_numbers(words: list[bytes]) -> list[float]:
    """Return three numbers; a single one stands for all three."""
    numbers = [float(word) for word in words[:3]]
    if len(numbers) not in (1, 3) or not np.isfinite(numbers).all():
        raise MeshError(f"{b' '.join(words).decode('latin-1')[:40]!r} are not three numbers")
    return numbers * (3 // len(numbers))


def _read_number(words: _Words, key: bytes, default: float) -> float:
    if not words.get(key):
        return default
    number = float(words[key][-1])  # behind `-halo`, perhaps
    if not np.isfinite(number):
        raise MeshError(f"{key.decode()} is not finite")
    return number


def _limit(share: float) -> float:
    return min(1.0, max(0.0, share))


def _join_alpha(texture: Texture | None, mask: Texture | None) -> Texture | None:
    """Return a texture with the alpha of a mask, and opaque without one.

    The alpha of a mask is that of its pixels, or their grey if they are opaque.
    """
    if mask is None:
        return texture and with_alpha(texture, OPAQUE)
    alpha = mask.pixels[..., 0] if mask.is_opaque else mask.pixels[..., 3]
    if texture is None:
        white = np.full((*alpha.shape, 4), OPAQUE, np.uint8)
        return with_alpha(Texture(mask.name, white, True, mask.wrap), alpha)
    if alpha.shape == texture.pixels.shape[:2]:
        return with_alpha(texture, alpha)
    # To the size of the larger one, pixel by pixel.
    height, width = np.maximum(alpha.shape, texture.pixels.shape[:2])
    pixels, alpha = (
        values[np.arange(height)[:, None] * len(values) // height, np.arange(width) * values.shape[1] // width]
        for values in (texture.pixels, alpha)
    )
    return with_alpha(dataclasses.replace(texture, pixels=pixels), alpha)
