"""A picture that is spread over a surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import MeshError
from ..arrays import as_array

WRAPS = ("repeat", "clamp", "mirror")
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

    Attributes
    ----------
    pixels : (h, w, 4) uint8
        Not writable.

    Raises
    ------
    MeshError
        Pixels of another shape or dtype, none, or more than 16,384 on a side; an unknown wrap.

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

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", _check_pixels(self.pixels, self.name))
        object.__setattr__(self, "is_srgb", bool(self.is_srgb))
        wrap: Any = (self.wrap, self.wrap) if isinstance(self.wrap, str) else self.wrap
        if not isinstance(wrap, tuple | list) or len(wrap) != 2 or any(one not in WRAPS for one in wrap):
            raise MeshError(f"texture {self.name}: the wrap must be two of {', '.join(WRAPS)}, not {self.wrap!r}")
        object.__setattr__(self, "wrap", tuple(wrap))

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
    copied = np.full((*array.shape[:2], 4), OPAQUE, np.uint8)
    copied[..., : array.shape[2]] = array
    copied.flags.writeable = False
    return copied
