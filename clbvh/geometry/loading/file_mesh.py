"""Meshes as files have them, and the steps that their readers share: values of corners, problems.

Values are spread from the lists of the file to the corners of its triangles. What is wrong with the looks becomes one
warning for all of it, and the triangles are read nevertheless.
"""

from __future__ import annotations

import codecs
import io
import os
import re
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import AppearanceWarning, ClbvhError, MeshError, shorten_message
from ...support.files import read_regular
from ..appearance.appearance import Appearance, find_flat_normals, make_unchecked, normalize
from ..appearance.material import Material, copy_with_alpha
from ..appearance.srgb import to_bytes
from ..mesh import Part

# The letters before OFF announce more numbers per vertex, all of them behind the coordinates.
# In small letters they are all small: `nOFF` announces another dimension. Some programs write the counts right behind.
OFF_KEYWORD = re.compile(rb"\s*(?:#[^\n]*\n\s*)*(?:((?:ST)?C?N?)OFF|((?:st)?c?n?)off)(?![A-Za-z_])")

_STL_COUNT = slice(80, 84)  # bytes of a binary file that hold the number of its triangles
_STL_TRIANGLE_BYTES = 50


class FileMesh(NamedTuple):
    """A mesh as the file has it, (V, 3) float and (F, 3) int, and its looks. The name may be empty.

    Where the file has no normals and declares faces flat, `flat_faces` is (F,) bool. The names of parts may be empty.
    Without faces, `point_colours` are those of the vertices, (V, 4) uint8, if there are any.
    """

    name: str
    vertices: NDArray[np.number]
    faces: NDArray[np.integer]
    appearance: Appearance | None = None
    flat_faces: NDArray[np.bool_] | None = None
    parts: tuple[Part, ...] = ()
    point_colours: NDArray[np.uint8] | None = None


class PointCloudError(MeshError):
    """A file has points and no faces.

    Attributes
    ----------
    cloud : FileMesh
    """

    cloud: FileMesh


def read_named(path: Path, *, max_bytes: int | None = None) -> bytes:
    """Return the content of a file that another one names; `MeshError` says what is wrong with it."""
    try:
        return read_regular(path, max_bytes=max_bytes)
    except FileNotFoundError:
        raise MeshError(f"{path} is missing") from None
    except OSError as error:
        raise MeshError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise MeshError(f"{str(path)!r} cannot be read: this is not the path of a file") from error


_MAX_SHOWN = 3  # problems in a warning
_PACKAGE = Path(__file__).parents[2]


class Problems:
    """Sentences about attributes that cannot be used."""

    def __init__(self) -> None:
        self._sentences: dict[str, None] = {}

    def add(self, sentence: str) -> None:
        """Remember a sentence; equal ones count as one."""
        self._sentences[sentence] = None

    @contextmanager
    def drop(self, subject: str) -> Iterator[None]:
        """Turn any error of the statements into a sentence: what they would have set is dropped.

        Files may hold anything, and decoders raise anything.
        """
        try:
            yield
        except Exception as error:
            detail = shorten_message(error) if isinstance(error, ClbvhError) else "damaged, or of an unknown kind"
            self.add(f"{subject} cannot be used: {detail}")

    def warn(self, source: str) -> None:
        """Issue one `AppearanceWarning` about a file, if there is a sentence."""
        if not self._sentences:
            return
        sentences = list(self._sentences)
        rest = f"; and {len(sentences) - _MAX_SHOWN} more" if len(sentences) > _MAX_SHOWN else ""
        text = f"{source}: {'; '.join(sentences[:_MAX_SHOWN])}{rest}"
        warnings.warn(text, AppearanceWarning, stacklevel=_count_own_frames())


def _count_own_frames() -> int:
    """Return the stack level of the first caller outside of clbvh, as `warn` counts from the method above."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_code.co_filename.startswith(f"{_PACKAGE}{os.sep}"):
        frame, level = frame.f_back, level + 1
    return level


# The colours of a file that has no materials are not tinted.
_WHITE = Material(base_colour=(1.0, 1.0, 1.0))


def finish_looks(arrays: Mapping[str, NDArray], materials: Sequence[Material]) -> Appearance | None:
    """Return an appearance of checked arrays, None if there is nothing to say.

    Colours without a material are those of a white one. A material that differs in nothing from the one that every
    surface has is none.
    """
    if not materials and "colours" in arrays:
        materials = [_WHITE]
    if not arrays and all(material == Material() for material in materials):
        return None
    return make_unchecked(**arrays, materials=tuple(materials))


def read_table(lines: bytes) -> NDArray[np.float64] | None:
    """Return the numbers of a text, line by line; None if there is anything else, or not as many on each line."""
    if not lines.strip():
        return None
    with suppress(ValueError):
        return np.loadtxt(io.BytesIO(lines), comments=None, encoding="ascii", ndmin=2)
    return None


_MAX_BYTE = 255


def spread_normals(
    normals: NDArray[np.number],
    ids: NDArray[np.integer],
    vertices: NDArray[np.number],
    faces: NDArray[np.integer],
) -> NDArray[np.float32]:
    """Return unit normals at corners, (F, 3, 3) float32. Corners without one have that of their face.

    Parameters
    ----------
    normals : (n, 3) float
        Of any length. Those of length 0 are none.
    ids : (F, 3) int
        The normal of each corner; -1 where it has none.
    vertices, faces : (V, 3) float and (F, 3) int
        The triangles.

    Raises
    ------
    MeshError
        A normal is not finite, or an id is out of range.
    """
    check_ids(ids, len(normals))
    if not np.isfinite(normals).all():
        raise MeshError("some are not finite")
    unit, has_direction = normalize(normals)
    if has_direction.all() and (len(ids) == 0 or ids.min() >= 0):
        return np.take(unit, ids, axis=0)  # three times as fast as an index
    # The last one is for the id -1.
    spread = np.concatenate((unit, np.zeros((1, 3), np.float32)))[ids]
    missing = ~np.append(has_direction, False)[ids]
    lacking = np.flatnonzero(missing.any(axis=1))
    # A face that has a vertex out of range is refused later.
    flat = find_flat_normals(vertices[np.clip(faces[lacking], 0, len(vertices) - 1)])
    spread[lacking] = np.where(missing[lacking][..., None], flat[:, None], spread[lacking])
    return spread


def spread_uvs(uvs: NDArray[np.number], ids: NDArray[np.integer]) -> NDArray[np.float32]:
    """Return texture coordinates at corners, (F, 3, 2) float32; (0, 0) where the id is -1.

    Raises
    ------
    MeshError
        A coordinate is not finite, or an id is out of range.
    """
    check_ids(ids, len(uvs))
    with np.errstate(over="ignore"):
        small = uvs.astype(np.float32)
    if not np.isfinite(small).all():
        raise MeshError("some are not finite")
    if len(ids) and ids.min() < 0:
        small = np.concatenate((small, np.zeros((1, 2), np.float32)))
    # Two numbers are one of eight bytes: gathered ten times as fast.
    pairs = np.ascontiguousarray(small).view(np.uint64)[:, 0]
    return pairs[ids][..., None].view(np.float32)


def join_channels(channels: list[NDArray[np.number]], dtype: np.dtype) -> NDArray[np.uint8]:
    """Return colours, (n, 4) uint8, of three or four lists of numbers.

    Parameters
    ----------
    channels : list of (n,) number
        Red, green, blue and perhaps alpha.
    dtype : dtype
        The type of the file: whole numbers are shares of 255, or of the greatest of 16 bits; others are shares of 1,
        but of 255 if one is above 1.

    Raises
    ------
    MeshError
        A number is NaN.
    """
    whole = dtype.kind in "iu"
    if whole and all(channel.dtype == np.uint8 for channel in channels):
        values = np.column_stack(channels)
    else:
        numbers = np.column_stack(channels)
        if np.isnan(numbers).any():
            raise MeshError("a colour is not a number")
        if whole:
            most = np.iinfo(np.uint16).max if dtype.itemsize == 2 else _MAX_BYTE
        else:
            most = _MAX_BYTE if len(numbers) and numbers.max(initial=0) > 1 else 1
        values = to_bytes(numbers / np.float32(most))
    return copy_with_alpha(values)


def check_ids(ids: NDArray[np.integer], count: int) -> None:
    """Raise `MeshError` if an id is out of range; -1 is allowed."""
    if len(ids) and not -1 <= int(ids.min()) <= int(ids.max()) < count:
        raise MeshError(f"a corner refers to one that is not among the {count:,}")


def spread_colours(colours: NDArray[np.uint8], ids: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Return colours at corners, (F, 3, 4) uint8, of a list, (n, 4) uint8."""
    check_ids(ids, len(colours))
    # Four bytes are one number: gathered four times as fast.
    return colours.view(np.uint32)[:, 0][ids][..., None].view(np.uint8)


def find_stl_end(data: bytes) -> int:
    """Return the size that the header of a binary STL file would declare; in a text, that of gigabytes.

    The first word tells nothing: many programs begin binary files with `solid`, as text files do.
    """
    return _STL_COUNT.stop + int.from_bytes(data[_STL_COUNT], "little") * _STL_TRIANGLE_BYTES


def has_stl_triangles(data: bytes) -> bool:
    """Return whether there are all triangles that the header of a binary STL file would declare, and one at least."""
    return _STL_COUNT.stop < find_stl_end(data) <= len(data)


def decode_text(data: bytes) -> bytes:
    """Return a text in UTF-8 without the mark that some editors put before it; other bytes as they are.

    Raises
    ------
    MeshError
        The mark is that of UTF-16, and the rest is not.
    """
    if not data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.removeprefix(codecs.BOM_UTF8)
    try:
        return data.decode("utf-16").encode()
    except UnicodeError as error:
        raise MeshError("the text in UTF-16 is damaged or cut off") from error
