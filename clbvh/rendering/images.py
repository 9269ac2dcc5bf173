"""The images of one view: arrays by the names of their channels, and their files; JSON files of cameras.

A file is one EXR, or a PNG or PPM for each channel, checked before the work begins.
"""

from __future__ import annotations

import json
import math
import os
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, SceneError
from ..files.image_files import encode_ppm, import_openexr, write_exr
from ..geometry.appearance.srgb import linear_to_srgb
from ..support.files import as_path, check_target, read_errors_as, read_regular, write_atomically
from ..support.memory import check_memory
from ..views.cameras.camera import Camera
from ..views.view import View
from .channels import CHANNELS, NextPose, Subject, check_channels
from .picture import Picture


@dataclass(frozen=True, eq=False, repr=False)
class Images(Mapping[str, NDArray[Any]]):
    """Images of one view for programs: a mapping of channels to arrays of (height, width) or (height, width, k).

    All but the colours and alpha belong to the centre of each pixel: they are never mixed of several surfaces. They are
    computed in float64 on the file's own vertices, like every hit.

    | channel | array | a miss holds |
    |---|---|---|
    | rgb | (h, w, 3) uint8: the picture, sRGB | the background |
    | colour | (h, w, 3) float32: the picture, linear, before exposure and tone curve | the background |
    | alpha | (h, w) float32: the share of the pixel that is covered | 0 |
    | depth | (h, w) float32: distance along the optical axis, the z of depth cameras | inf |
    | range | (h, w) float32: distance along the ray, the t of hits | inf |
    | normal | (h, w, 3) float32: of the primitive, of length 1, towards the camera, the scene's axes | 0 |
    | normal_camera | the same along the camera's axes: x right, y down, z forward, as in OpenCV | 0 |
    | shading_normal, shading_normal_camera | the file's at vertices, or smooth ones | 0 |
    | position | (h, w, 3) float64: the scene's coordinates | NaN |
    | instance_id, geometry_id, prim_id | (h, w) int32 | -1 |
    | barycentric | (h, w, 2) float32: u and v of hits | NaN |
    | uv | (h, w, 2) float32: texture coordinates, (0, 0) at the lower left | NaN, also without such coordinates |
    | motion | (h, w, 2) float32: pixels to the right and downwards, to the second pose | NaN, also behind the camera |

    Attributes
    ----------
    camera : Camera
    geometry_names, instance_names : tuple of str
        By their ids.

    Examples
    --------
    >>> import clbvh
    >>> ball = clbvh.make_shape("icosphere", triangles=5120)
    >>> camera = clbvh.Camera(eye=(0, 0, 3), look_at=(0, 0, 0))
    >>> images = clbvh.render_images(ball, ("depth", "normal_camera"), camera=camera, width=65, height=65)
    >>> images
    Images(65 x 65: depth, normal_camera)
    >>> images["depth"][32, 32].round(2).item(), images["normal_camera"][32, 32].round(1) + 0
    (2.0, array([ 0.,  0., -1.], dtype=float32))
    """

    _arrays: dict[str, NDArray[Any]]
    camera: Camera
    geometry_names: tuple[str, ...] = field(kw_only=True)
    instance_names: tuple[str, ...] = field(kw_only=True)

    def __getitem__(self, channel: str) -> NDArray[Any]:
        if channel not in self._arrays:
            raise KeyError(f"the images have the channels {', '.join(self._arrays)}, not {channel!r}")
        return self._arrays[channel]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        return f"Images({self.width} x {self.height}: {', '.join(self)})"

    @property
    def height(self) -> int:
        """Rows of the images."""
        return next(iter(self._arrays.values())).shape[0]

    @property
    def width(self) -> int:
        """Columns of the images."""
        return next(iter(self._arrays.values())).shape[1]

    @property
    def camera_to_world(self) -> NDArray[np.float64]:
        """(4, 4) float64: the pose of the camera with the axes of OpenCV; see `Camera.from_intrinsics`."""
        return self.camera.camera_to_world("opencv")

    @property
    def intrinsics(self) -> NDArray[np.float64] | None:
        """(3, 3) float64, pixels: the camera's matrix; None for a camera that has none."""
        try:
            return self.camera.intrinsics(self.width, self.height)
        except SceneError:
            return None

    def save(self, path: str | os.PathLike[str], *, depth_scale: float | None = None) -> None:
        """Write all channels to one ``.exr`` or ``.npz`` file, or each to a ``.png`` or ``.ppm`` file of its own.

        Parameters
        ----------
        path : str or path
            The suffix decides:

            - ``.npz``: each array by the name of its channel, bit for bit, and `camera_to_world`, `intrinsics`,
              `size` (width, height), `geometry_names`, `instance_names`.
            - ``.exr``: float32 and uint32, in layers: R, G, B (`colour`), A, depth.Z, normal.X and so on; ids are
              uint32 with 4294967295 on a miss. `position` is rounded to float32; `rgb` is left out, `colour` has it.
              Camera and names stand in the head. Needs OpenEXR.
            - ``.png``: `out.png` stands for out-depth.png, out-normal.png and so on, with 16 bits but for `rgb` and
              `alpha`, and out.json, which has the camera, the names, and for each channel `scale` and `offset`:
              ``value = pixel / scale + offset``; pixel 0 is a miss. A pair has a third channel, 1 on a hit. Ids
              beyond 65534 have 8 bits: the pixel is ``R + 256 G + 65536 B``.
            - ``.ppm``: the same without compression.
        depth_scale : float, optional
            Of `depth` and `range` in PNG and PPM files: pixel values for a unit of length, 1000 for millimetres where
            the unit is the metre. By default the largest of 1, 2, 5, 10, 20 and so on (or 0.5, 0.2, ...) that fits.

        Raises
        ------
        ConfigError
            Another suffix, a file that cannot be written, a channel that the format cannot hold, a depth that
            `depth_scale` makes larger than 65535, or OpenEXR is not installed.

        Examples
        --------
        >>> import clbvh
        >>> import tempfile
        >>> import numpy as np
        >>> from pathlib import Path
        >>> images = clbvh.render_images(clbvh.make_shape("icosphere", triangles=320), width=64, height=48)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     images.save(Path(folder, "ball.npz"))
        ...     images.save(Path(folder, "ball.png"), depth_scale=1000)
        ...     with np.load(Path(folder, "ball.npz")) as loaded:
        ...         print(bool((loaded["depth"] == images["depth"]).all()))
        ...     print(sorted(path.name for path in Path(folder).iterdir())[:3])
        True
        ['ball-alpha.png', 'ball-depth.png', 'ball-instance_id.png']
        """
        target = check_images_path(path, self)
        suffix = target.suffix.lower()
        if depth_scale is not None and suffix not in FILES_SUFFIXES:
            raise ConfigError(f"depth_scale is for PNG and PPM files: {suffix} files hold the distances themselves")
        facts = self._describe()
        if suffix == ".npz":
            arrays: dict[str, Any] = {**self._arrays, **facts}
            write_atomically(target, lambda file: np.savez(file, **arrays))
        elif suffix == ".exr":
            _write_exr(target, self._arrays, facts)
        else:
            _write_image_files(target, self._arrays, facts, depth_scale)

    def _describe(self) -> dict[str, NDArray[Any]]:
        """Return the camera and the names as arrays."""
        matrix = self.intrinsics
        return {
            "camera_to_world": self.camera_to_world,
            **({} if matrix is None else {"intrinsics": matrix}),
            "size": np.array([self.width, self.height]),
            "geometry_names": np.array(self.geometry_names, np.str_),
            "instance_names": np.array(self.instance_names, np.str_),
        }


# Hits in float64, and vectors on the way to them.
_PIXEL_BYTES = 100


def make_images(
    render: Callable[..., Picture], view: View, channels: Iterable[str], second: tuple[Any, Any, Any], on_phase: Any
) -> Images:
    """Return the images of `Renderer.images`, of a picture that `render` makes of a view; `second`: of `NextPose`."""
    names, next_pose = check_channels(channels), NextPose(*second)
    if "motion" in names:
        next_pose.check()
    keeps_film = "colour" in names or "alpha" in names
    if not any(CHANNELS[name].needs_shading for name in names):
        # One ray for each pixel, and none to the light.
        view = view.changed(shading="normal", samples=None)
    picture = render(view, keeps_film=keeps_film, on_phase=on_phase)
    pixel_bytes = _PIXEL_BYTES + sum(CHANNELS[name].pixel_bytes for name in names)
    check_memory("the images", picture.found.size * pixel_bytes, SceneError)
    state = picture.scene.state
    subject = Subject(picture, next_pose, view.smooth)
    arrays: dict[str, NDArray[Any]] = {
        name: CHANNELS[name].find(subject).astype(CHANNELS[name].dtype, copy=False) for name in names
    }
    return Images(arrays, picture.camera, geometry_names=state.names, instance_names=state.instance_names)


IMAGES_SUFFIXES = (".exr", ".npz", ".png", ".ppm")

# One file for each channel.
FILES_SUFFIXES = (".png", ".ppm")


def check_images_path(path: str | os.PathLike[str], channels: Iterable[str]) -> Path:
    """Return the path of images; raise `ConfigError` unless these channels can be written there."""
    target = as_path(path)
    suffix = target.suffix.lower()
    if suffix not in IMAGES_SUFFIXES:
        raise ConfigError(f"{target}: the name of images must end in {', '.join(IMAGES_SUFFIXES)}")
    files = [target]
    if suffix in FILES_SUFFIXES:
        files = [target.with_suffix(".json"), *(_file_of(target, channel) for channel in channels)]
    for each in files:
        check_target(each)
    if suffix == ".exr":
        import_openexr()
        _list_exr_channels(channels)
    return target


def _list_exr_channels(channels: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return the EXR channels of each channel that has some; raise `ConfigError` if none has."""
    names = {channel: CHANNELS[channel].exr_names for channel in channels if CHANNELS[channel].exr_names}
    if not names:
        raise ConfigError("an EXR file has no 8-bit colours: ask for the channel colour in place of rgb")
    return names


def _write_exr(path: Path, arrays: Mapping[str, NDArray[Any]], facts: Mapping[str, NDArray[Any]]) -> None:
    """Write an EXR file; the camera and the names become attributes in JSON."""
    parts: dict[str, NDArray[Any]] = {}
    for channel, names in _list_exr_channels(arrays).items():
        array = arrays[channel]
        # The same 32 bits: -1 becomes the largest number.
        array = array.view(np.uint32) if array.dtype == np.int32 else array.astype(np.float32, copy=False)
        parts.update(zip(names, np.moveaxis(array.reshape(*array.shape[:2], -1), 2, 0), strict=True))
    attributes = {name: json.dumps(values.tolist()) for name, values in facts.items()}
    write_atomically(path, lambda file: write_exr(file, parts, attributes))


_MOST_BYTE, _MOST, _MOST_COLOUR = 255, 2**16 - 1, 2**24 - 1

# Directions: -1 is pixel 1, 0 is the middle, and 1 the last pixel value.
_DIRECTION_SCALE = 32767

_NOTE = "clbvh"

# Each row as its difference to the row above.
_PNG_UP_FILTER = 2


class Coded(NamedTuple):
    """Pixels, and what they stand for: ``value = pixel / scale + offset``; `is_linear` is false for colours.

    With `bytes_of_id`, the pixel is R + 256 G + 65536 B.
    """

    pixels: NDArray[Any]
    scale: float
    offset: float
    is_linear: bool = True
    bytes_of_id: bool = False


def _write_image_files(
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
            files[target] = _encode_png(coded.pixels, json.dumps({"channel": channel, **notes[channel]}))
    described = {name: values.tolist() for name, values in facts.items()} | {"channels": notes}
    # A line for each fact.
    lines = (f"{json.dumps(name)}: {json.dumps(value)}" for name, value in described.items())
    files[path.with_suffix(".json")] = ("{\n" + ",\n".join(lines) + "\n}\n").encode()
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


def _encode_png(pixels: NDArray[Any], note: str) -> bytes:
    """Return a PNG file of grey or colours with a note in ASCII; written here, as Pillow has no colours of 16 bits."""
    height, width = pixels.shape[:2]
    rows = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">"))).view(np.uint8).reshape(height, -1)
    filtered = np.full((height, 1 + rows.shape[1]), _PNG_UP_FILTER, np.uint8)
    filtered[:, 1:] = np.diff(rows, axis=0, prepend=np.zeros_like(rows[:1]))
    colour_type = 0 if pixels.ndim == 2 else 2
    chunks = {
        b"IHDR": struct.pack(">IIBBBBB", width, height, 8 * pixels.itemsize, colour_type, 0, 0, 0),
        b"tEXt": f"{_NOTE}\0{note}".encode(),
        b"IDAT": zlib.compress(filtered.data, level=1),
        b"IEND": b"",
    }
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks.items()
    )


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


def _file_of(path: Path, channel: str) -> Path:
    return path.with_name(f"{path.stem}-{channel}{path.suffix.lower()}")


_NEEDED = ("intrinsics", "camera_to_world", "size")
_OPTIONAL = ("convention", "pixel_centres")

_MOST_BYTES = 1 << 26


def read_camera(path: str | os.PathLike[str]) -> Camera:
    """Return the camera of a JSON file.

    Parameters
    ----------
    path : str or path
        An object with `intrinsics` (3, 3), `camera_to_world` (4, 4), `size` (width, height) and, if needed,
        `convention` and `pixel_centres`: the arguments of `Camera.from_intrinsics`. Other keys are left alone.

    Raises
    ------
    SceneError
        The file cannot be read, or it describes no camera.
    """
    with read_errors_as(SceneError, path):
        content = read_regular(Path(path), max_bytes=_MOST_BYTES)
    try:
        facts = json.loads(content)
    except ValueError as error:
        raise SceneError(f"{path}: this is no JSON file: {error}") from error
    if not isinstance(facts, dict):
        raise SceneError(f"{path}: a camera file holds an object with {', '.join(_NEEDED)}")
    if missing := [key for key in _NEEDED if key not in facts]:
        raise SceneError(f"{path}: a camera file needs {', '.join(_NEEDED)}, and here is no {missing[0]}")
    try:
        others = {key: facts[key] for key in _OPTIONAL if key in facts}
        return Camera.from_intrinsics(*(facts[key] for key in _NEEDED), **others)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
