"""Images as PNG or PPM files, one for each channel: numbers of 16 bits, with the scale beside them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ...geometry.appearance.srgb import linear_to_srgb
from ...support.atomic_file import check_target, write_atomically
from ..formats.png import encode_png
from ..formats.ppm import encode_ppm
from .channels import CHANNELS

_MOST_BYTE, _MOST, _MOST_COLOUR = 255, 2**16 - 1, 2**24 - 1

# Directions: -1 is pixel 1, 0 is the middle, and 1 the last pixel value.
_DIRECTION_SCALE = 32767

_NOTE = "clbvh"


class Coded(NamedTuple):
    """Pixels, and what they stand for: ``value = pixel / scale + offset``; `is_linear` is false for colours.

    With `bytes_of_id`, the pixel is R + 256 G + 65536 B.
    """

    pixels: NDArray[Any]
    scale: float
    offset: float
    is_linear: bool = True
    bytes_of_id: bool = False


def check_file_targets(path: Path, channels: Iterable[str]) -> None:
    """Raise `ConfigError` unless all files of these channels can be written."""
    for target in (path.with_suffix(".json"), *(_file_of(path, channel) for channel in channels)):
        check_target(target)


def write_image_files(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    facts: Mapping[str, NDArray[Any]],
    depth_scale: float | None,
) -> None:
    """Write a PNG or PPM file for each channel, and a JSON file with their scales.

    Parameters
    ----------
    path : Path
        ``out.png`` stands for ``out-CHANNEL.png`` and ``out.json``, ``out.ppm`` likewise.
    arrays : mapping of channels to arrays
    facts : mapping of str to array
        Camera and names, for the JSON file.
    depth_scale : float or None
        Pixel values for a unit of length; None: a round number that fits.

    Raises
    ------
    ConfigError
        A scale that is not above 0 or too large, or an id beyond 16,777,214.
    """
    if depth_scale is not None and (
        isinstance(depth_scale, bool) or not isinstance(depth_scale, Real) or not 0 < depth_scale < math.inf
    ):
        raise ConfigError(f"depth_scale must be a finite number above 0, not {depth_scale!r}")
    # All is encoded before anything is written, so that a value that does not fit leaves no file.
    notes: dict[str, dict[str, Any]] = {}
    files: dict[Path, bytes] = {}
    for channel, array in arrays.items():
        coded = encode_channel(channel, array, depth_scale)
        target = _file_of(path, channel)
        notes[channel] = {"file": target.name}
        if coded.is_linear:
            notes[channel] |= {"scale": coded.scale, "offset": coded.offset}
        if coded.bytes_of_id:
            notes[channel]["pixel"] = "R + 256 G + 65536 B"
        if target.suffix == ".ppm":
            files[target] = encode_ppm(coded.pixels)
        else:
            files[target] = encode_png(coded.pixels, {_NOTE: json.dumps({"channel": channel, **notes[channel]})})
    described = {name: values.tolist() for name, values in facts.items()}
    files[path.with_suffix(".json")] = _show_facts({**described, "channels": notes}).encode()
    for target, content in files.items():
        write_atomically(target, lambda file, content=content: file.write(content))  # type: ignore[misc]


def encode_channel(channel: str, array: NDArray[Any], depth_scale: float | None = None) -> Coded:
    """Return the pixels of a channel, (height, width) or (height, width, 3) uint8 or uint16."""
    kind = CHANNELS[channel].kind
    if kind == "rgb":
        return Coded(array, _MOST_BYTE, 0.0, is_linear=False)
    if kind == "colour":
        return Coded(_round(linear_to_srgb(array) * _MOST), _MOST, 0.0, is_linear=False)
    if kind == "share":
        return Coded(np.rint(array * _MOST_BYTE).astype(np.uint8), _MOST_BYTE, 0.0)
    if kind == "id":
        return _encode_ids(channel, array)
    if kind == "direction":
        is_hit = array.any(axis=-1, keepdims=True)
        pixels = np.where(is_hit, np.rint((array.astype(np.float64) + 1) * _DIRECTION_SCALE) + 1, 0)
        return Coded(_round(pixels), _DIRECTION_SCALE, -1 - 1 / _DIRECTION_SCALE)
    is_known = np.isfinite(array)
    values = array[is_known].astype(np.float64)
    if kind == "distance" and (not len(values) or values.min() > 0):
        return _encode_distances(channel, array, float(values.max(initial=0.0)), depth_scale)
    return _encode_vectors(array, is_known, values)


def _encode_ids(channel: str, ids: NDArray[np.int32]) -> Coded:
    """Count from 1; beyond 16 bits over red, green and blue, the lowest byte first, as in COCO's panoptic files."""
    most = int(ids.max(initial=0))
    if most < _MOST:
        return Coded((ids + 1).astype(np.uint16), 1.0, -1.0)
    if most >= _MOST_COLOUR:
        raise ConfigError(
            f"a picture file has {channel} up to {_MOST_COLOUR - 1:,}, and here it goes to {most:,}: write .exr or .npz"
        )
    counted = np.ascontiguousarray(ids + 1).astype("<u4")
    return Coded(counted.view(np.uint8).reshape(*ids.shape, 4)[..., :3], 1.0, -1.0, bytes_of_id=True)


def _encode_distances(channel: str, array: NDArray[Any], most: float, scale: float | None) -> Coded:
    if scale is None:
        scale = _round_scale(_MOST / most) if most > 0 else 1.0
    elif most * scale > _MOST:
        raise ConfigError(
            f"{channel} goes to {most:g}, and {scale:g} times that is more than {_MOST:,}: depth_scale can be "
            f"{_MOST / most:g} at most"
        )
    # 0 is a miss, so that the nearest distance is 1.
    pixels = np.where(np.isfinite(array), np.maximum(np.rint(array.astype(np.float64) * scale), 1), 0)
    return Coded(_round(pixels), float(scale), 0.0)


def _encode_vectors(array: NDArray[Any], is_known: NDArray[np.bool_], values: NDArray[np.float64]) -> Coded:
    """Spread the values over all pixel values but 0; a pair gets a third channel, 1 where it is known."""
    least, most = float(values.min(initial=np.inf)), float(values.max(initial=-np.inf))
    scale = (_MOST - 1) / (most - least) if most > least else 1.0
    offset = least if len(values) else 0.0
    pixels = np.zeros(array.shape, np.uint16)
    pixels[is_known] = _round((values - offset) * scale + 1)
    if array.ndim == 3 and array.shape[2] == 2:
        pixels = np.concatenate((pixels, is_known.all(axis=-1, keepdims=True)), axis=-1, dtype=np.uint16)
    return Coded(pixels, scale, offset - 1 / scale)


def _round_scale(most: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, ... and of their inverses that is at most this."""
    exponent = math.floor(math.log10(most))
    return next(
        (scale for digit in ("5", "2") if (scale := float(f"{digit}e{exponent}")) <= most), float(f"1e{exponent}")
    )


def _round(values: NDArray[np.floating]) -> NDArray[np.uint16]:
    return np.clip(np.rint(values), 0, _MOST).astype(np.uint16)


def _show_facts(facts: Mapping[str, Any]) -> str:
    """Return JSON with a line for each fact."""
    return "{\n" + ",\n".join(f"{json.dumps(name)}: {json.dumps(value)}" for name, value in facts.items()) + "\n}\n"


def _file_of(path: Path, channel: str) -> Path:
    return path.with_name(f"{path.stem}-{channel}{path.suffix.lower()}")
