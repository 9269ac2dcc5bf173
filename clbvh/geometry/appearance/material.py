"""How a surface reflects, emits and lets through light, and the pictures that are spread over it.

Brent Burley, "Physically Based Shading at Disney", 2012, for the parameters, as glTF 2.0 has them.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import MeshError
from ...support.settings import Kind, Vector, check_settings, number, only, setting, vector
from ..arrays import as_array

WRAPS = ("repeat", "clamp", "mirror")
FILTERS = ("linear", "nearest")
OPAQUE = 255

# Sides of a picture that devices can address, and that decoders can make of a few bytes of a forged file.
MAX_TEXTURE_SIDE = 16_384


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture that is spread over a surface by texture coordinates.

    The coordinates (0, 0) are the lower left corner of the picture, and (1, 1) the upper right one, as in OBJ files.

    Parameters
    ----------
    name : str
        For messages: a file's name.
    pixels : (h, w, 4) uint8
        Red, green, blue and alpha; row 0 is the top. (h, w, 3) and (h, w) are accepted as well: opaque, and grey.
    is_srgb : bool
        Whether the colours are sRGB, as those of photographs; otherwise they are linear numbers. Alpha is linear.
    wrap : pair of str, or str
        What lies beyond the edges, in u and v: ``repeat``, ``clamp`` (the pixels at the edge) or ``mirror``.
    filter : str
        ``linear``: colours go over into each other between the centres of pixels; ``nearest``: pixels are squares.

    Attributes
    ----------
    pixels : (h, w, 4) uint8
        Not writable.

    Raises
    ------
    MeshError
        Pixels of another shape or dtype, none, or more than 16,384 on a side; an unknown wrap or filter.

    Notes
    -----
    Textures are equal only to themselves: parts of a mesh share one by holding the same object.

    Examples
    --------
    >>> import clbvh
    >>> import numpy as np
    >>> checker = np.array([[0, 255], [255, 0]], np.uint8)
    >>> clbvh.Texture("checker", checker)
    Texture('checker', 2 x 2)
    >>> clbvh.Texture("checker", checker, wrap="clamp").wrap
    ('clamp', 'clamp')
    """

    name: str
    pixels: NDArray[np.uint8]
    is_srgb: bool = True
    wrap: tuple[str, str] = ("repeat", "repeat")
    filter: str = "linear"

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", _check_pixels(self.pixels, self.name))
        object.__setattr__(self, "is_srgb", bool(self.is_srgb))
        wrap: Any = (self.wrap, self.wrap) if isinstance(self.wrap, str) else self.wrap
        if not isinstance(wrap, tuple | list) or len(wrap) != 2 or any(one not in WRAPS for one in wrap):
            raise MeshError(f"texture {self.name}: the wrap must be two of {', '.join(WRAPS)}, not {self.wrap!r}")
        object.__setattr__(self, "wrap", tuple(wrap))
        if self.filter not in FILTERS:
            raise MeshError(f"texture {self.name}: the filter must be {' or '.join(FILTERS)}, not {self.filter!r}")

    @property
    def width(self) -> int:
        """Pixels in a row."""
        return self.pixels.shape[1]

    @property
    def height(self) -> int:
        """Rows of pixels."""
        return self.pixels.shape[0]

    @property
    def is_opaque(self) -> bool:
        """Whether no pixel lets anything through."""
        return bool((self.pixels[..., 3] == OPAQUE).all())

    def __repr__(self) -> str:
        return f"Texture({self.name!r}, {self.width} x {self.height})"


def _check_pixels(pixels: ArrayLike, name: str) -> NDArray[np.uint8]:
    """Return pixels as (h, w, 4), an array that cannot be written."""
    array = as_array(pixels, f"texture {name}: pixels", "(h, w, 4)")
    if array.dtype != np.uint8:
        raise MeshError(f"texture {name}: pixels must be uint8, from 0 to 255, not {array.dtype}")
    if array.ndim == 2:
        array = np.repeat(array[..., None], 3, axis=2)
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.size == 0:
        raise MeshError(f"texture {name}: pixels must have shape (h, w, 4), not {array.shape}")
    if max(array.shape) > MAX_TEXTURE_SIDE:
        raise MeshError(
            f"texture {name}: {array.shape[1]:,} x {array.shape[0]:,} pixels are more than {MAX_TEXTURE_SIDE:,} on a "
            "side: make the picture smaller"
        )
    copied = copy_with_alpha(array)
    copied.flags.writeable = False
    return copied


def copy_with_alpha(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a copy of colours, (..., 4); those without an alpha, (..., 3), are opaque."""
    copied = np.full((*colours.shape[:-1], 4), OPAQUE, np.uint8)
    copied[..., : colours.shape[-1]] = colours
    return copied


_TEXTURES = ("base_colour_texture", "metallic_roughness_texture", "emission_texture", "normal_texture")

# Light and refraction have limits that float32 arithmetic on a device bears well.
_MOST_EMISSION, _MOST_IOR, _MOST_NORMAL_SCALE = 1e12, 100.0, 100.0


_TEXTURE = Kind("a clbvh.Texture", only(lambda value: isinstance(value, Texture)), takes_arrays=True)


def _read_cutoff(value: Any) -> float:
    """Return an alpha that may be infinite: then nothing is there."""
    if isinstance(value, bool) or not value >= 0:
        raise ValueError
    return float(value)


@dataclass(frozen=True)
class Material:
    """How a surface looks: the parameters of glTF's metal-roughness model.

    Textures multiply the numbers beside them, and the colours of a mesh multiply the base colour. All colours here are
    linear; `clbvh.geometry.appearance.srgb.srgb_to_linear` converts those of a colour picker.

    Parameters
    ----------
    name : str
    base_colour : (3,) float from 0 to 1, linear
        Of a diffuse surface or a metal; of glass, what it lets through.
    alpha : float from 0 to 1
        How much of the surface is there.
    alpha_cutoff : float, optional
        The surface is there wherever alpha is at least this, and nowhere else: leaves, fences. None: alpha is the share
        of light that the surface stops.
    metallic : float from 0 to 1
    roughness : float from 0 to 1
        0 is a mirror. The square of it is the width of GGX's distribution.
    emission : (3,) float, linear
        Light that the surface sends out; may be above 1.
    ior : float, at least 1
        Index of refraction: 1.5 is glass and plastics, 1.33 water.
    transmission : float from 0 to 1
        The share of light that goes through the surface: 1 is glass.
    base_colour_texture : Texture, optional
        Multiplies `base_colour`, and its alpha `alpha`.
    metallic_roughness_texture : Texture, optional
        Its green multiplies `roughness`, and its blue `metallic`.
    emission_texture : Texture, optional
        Multiplies `emission`.
    normal_texture : Texture, optional
        Bends the normals of a mesh: red, green and blue from 0 to 1 are -1 to 1 along the growth of u, along that of v,
        and along the normal. Not sRGB.
    normal_scale : float from -100 to 100
        Of how far `normal_texture` bends them.

    Raises
    ------
    MeshError
        A value is out of range.

    Examples
    --------
    >>> import clbvh
    >>> gold = clbvh.Material("gold", base_colour=(1.0, 0.77, 0.34), metallic=1, roughness=0.2)
    >>> gold == clbvh.Material("gold", base_colour=(1.0, 0.77, 0.34), metallic=1, roughness=0.2)
    True
    >>> clbvh.Material(roughness=2)
    Traceback (most recent call last):
    clbvh.errors.MeshError: the material's roughness must be a number from 0 to 1, not 2
    """

    name: str = setting("", "For messages.", Kind("a text", only(lambda value: isinstance(value, str))))
    base_colour: Vector = setting((0.8, 0.72, 0.6), "Of a diffuse surface or a metal.", vector(0, 1))
    alpha: float = setting(1.0, "How much of the surface is there.", number(0, 1))
    alpha_cutoff: float | None = setting(
        None, "Alpha from which the surface is there.", Kind("a number of at least 0", _read_cutoff)
    )
    metallic: float = setting(0.0, "Share of a metal.", number(0, 1))
    roughness: float = setting(0.5, "0 is a mirror.", number(0, 1))
    emission: Vector = setting((0.0, 0.0, 0.0), "Light that the surface sends out.", vector(0, _MOST_EMISSION))
    ior: float = setting(1.5, "Index of refraction.", number(1, _MOST_IOR))
    transmission: float = setting(0.0, "Share of light that goes through.", number(0, 1))
    base_colour_texture: Texture | None = setting(None, "Multiplies the base colour and alpha.", _TEXTURE)
    metallic_roughness_texture: Texture | None = setting(None, "Multiplies roughness and metallic.", _TEXTURE)
    emission_texture: Texture | None = setting(None, "Multiplies the emission.", _TEXTURE)
    normal_texture: Texture | None = setting(None, "Bends normals.", _TEXTURE)
    normal_scale: float = setting(1.0, "Of bent normals.", number(-_MOST_NORMAL_SCALE, _MOST_NORMAL_SCALE))

    def __post_init__(self) -> None:
        check_settings(self, "the material's ", MeshError)

    @property
    def textures(self) -> tuple[Texture, ...]:
        """The textures that the material has."""
        found = (getattr(self, name) for name in _TEXTURES)
        return tuple(texture for texture in found if texture is not None)

    @property
    def is_opaque(self) -> bool:
        """Whether the surface is there wherever the mesh is, as far as the material says."""
        texture = self.base_colour_texture
        return self.alpha == 1.0 and (texture is None or texture.is_opaque)

    def __repr__(self) -> str:
        """Show what differs from a material without arguments."""
        shown = [
            f"{each.name}={value!r}"
            for each in dataclasses.fields(self)
            if (value := getattr(self, each.name)) != each.default
        ]
        return f"Material({', '.join(shown)})"
