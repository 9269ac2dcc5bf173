"""Textures as the device takes them: the texels of all in one table; see cl/looks/texture.cl."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ...geometry.appearance.texture import Texture
from ...structs import TEXTURE, TEXTURE_WRAPS


class TextureTables:
    """Textures, each once."""

    def __init__(self) -> None:
        self._numbers: dict[int, int] = {}  # by the identity of a texture, which `_textures` keeps alive
        self._textures: list[Texture] = []

    def number(self, texture: Texture | None) -> int:
        """Return the number of a texture, -1 for None."""
        if texture is None:
            return -1
        if id(texture) not in self._numbers:
            self._numbers[id(texture)] = len(self._textures)
            self._textures.append(texture)
        return self._numbers[id(texture)]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the tables by the names of the kernels' arguments.

        Raises
        ------
        SceneError
            The textures have more texels than the device counts.
        """
        rows = np.zeros(max(len(self._textures), 1), TEXTURE)
        counts = [texture.pixels.shape[0] * texture.pixels.shape[1] for texture in self._textures]
        most = np.iinfo(np.int32).max
        if sum(counts) > most:
            raise SceneError(f"the textures have {sum(counts):,} pixels, and the device counts up to {most:,}")
        first = 0
        for row, texture, count in zip(rows, self._textures, counts, strict=False):
            row["first_texel"], row["is_srgb"] = first, texture.is_srgb
            row["height"], row["width"] = texture.pixels.shape[:2]
            row["wrap"] = [TEXTURE_WRAPS[wrap] for wrap in texture.wrap]
            first += count
        texels = [np.ascontiguousarray(texture.pixels).view("<u4").reshape(-1) for texture in self._textures]
        return {
            "textures": rows,
            "texels": np.concatenate(texels).astype(np.uint32) if texels else np.zeros(1, np.uint32),
            "decoded_srgb": _decode_srgb(),
        }


def _decode_srgb() -> NDArray[np.float32]:
    """Return (256,) float32: the linear value of each 8-bit sRGB value (IEC 61966-2-1)."""
    encoded = np.arange(256) / 255.0
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)
