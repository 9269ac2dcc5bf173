"""Text in pictures: a font of 5 x 7 pixels, in capital letters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# In pixels of the font.
FONT_COLUMNS, FONT_ROWS, GAP = 5, 7, 1

# sRGB, of letters and of what is behind them.
INK = np.array([235, 238, 242], np.uint8)
GROUND = np.array([20, 24, 29], np.uint8)

TIMES = "\N{MULTIPLICATION SIGN}"

# One number for each row; the highest of five bits is the left pixel.
FONT = {
    " ": (0, 0, 0, 0, 0, 0, 0),
    "0": (14, 17, 19, 21, 25, 17, 14),
    "1": (4, 12, 4, 4, 4, 4, 14),
    "2": (14, 17, 1, 6, 8, 16, 31),
    "3": (30, 1, 1, 14, 1, 1, 30),
    "4": (2, 6, 10, 18, 31, 2, 2),
    "5": (31, 16, 30, 1, 1, 17, 14),
    "6": (6, 8, 16, 30, 17, 17, 14),
    "7": (31, 1, 2, 4, 8, 8, 8),
    "8": (14, 17, 17, 14, 17, 17, 14),
    "9": (14, 17, 17, 15, 1, 2, 12),
    "A": (14, 17, 17, 31, 17, 17, 17),
    "B": (30, 17, 17, 30, 17, 17, 30),
    "C": (14, 17, 16, 16, 16, 17, 14),
    "D": (30, 17, 17, 17, 17, 17, 30),
    "E": (31, 16, 16, 30, 16, 16, 31),
    "F": (31, 16, 16, 30, 16, 16, 16),
    "G": (14, 17, 16, 23, 17, 17, 14),
    "H": (17, 17, 17, 31, 17, 17, 17),
    "I": (14, 4, 4, 4, 4, 4, 14),
    "J": (7, 2, 2, 2, 2, 18, 12),
    "K": (17, 18, 20, 24, 20, 18, 17),
    "L": (16, 16, 16, 16, 16, 16, 31),
    "M": (17, 27, 21, 21, 17, 17, 17),
    "N": (17, 25, 21, 19, 17, 17, 17),
    "O": (14, 17, 17, 17, 17, 17, 14),
    "P": (30, 17, 17, 30, 16, 16, 16),
    "Q": (14, 17, 17, 17, 21, 18, 13),
    "R": (30, 17, 17, 30, 20, 18, 17),
    "S": (15, 16, 16, 14, 1, 1, 30),
    "T": (31, 4, 4, 4, 4, 4, 4),
    "U": (17, 17, 17, 17, 17, 17, 14),
    "V": (17, 17, 17, 17, 17, 10, 4),
    "W": (17, 17, 17, 21, 21, 21, 10),
    "X": (17, 17, 10, 4, 10, 17, 17),
    "Y": (17, 17, 10, 4, 4, 4, 4),
    "Z": (31, 1, 2, 4, 8, 16, 31),
    "(": (2, 4, 8, 8, 8, 4, 2),
    ")": (8, 4, 2, 2, 2, 4, 8),
    "+": (0, 4, 4, 31, 4, 4, 0),
    ",": (0, 0, 0, 0, 12, 4, 8),
    "-": (0, 0, 0, 31, 0, 0, 0),
    ".": (0, 0, 0, 0, 0, 12, 12),
    "/": (1, 1, 2, 4, 8, 16, 16),
    ":": (0, 12, 12, 0, 12, 12, 0),
    "?": (14, 17, 1, 2, 4, 0, 4),
    "_": (0, 0, 0, 0, 0, 0, 31),
    TIMES: (0, 0, 17, 10, 4, 10, 17),
}


def draw_text(pixels: NDArray[np.uint8], text: str, top: int, middle: int, scale: int) -> None:
    """Draw text into (height, width, 3) pixels, centred at a column; what does not fit is cut off.

    Small letters become capital ones, and signs that the font lacks question marks.
    """
    if not text:
        return
    columns = np.arange(FONT_COLUMNS - 1, -1 - GAP, -1)  # bits from the left; -1 is the gap to the next sign
    rows = [np.array(FONT.get(sign.upper(), FONT["?"]))[:, None] for sign in text]
    signs = [np.where(columns >= 0, each >> np.maximum(columns, 0) & 1, 0) for each in rows]
    mask = np.concatenate(signs, axis=1).astype(bool).repeat(scale, axis=0).repeat(scale, axis=1)
    left = max(0, middle - mask.shape[1] // 2)
    part = pixels[top : top + mask.shape[0], left : left + mask.shape[1]]
    part[mask[: part.shape[0], : part.shape[1]]] = INK


def width_of(text: str, scale: int) -> int:
    """Return the pixels that a text takes."""
    return (FONT_COLUMNS + GAP) * len(text) * scale
