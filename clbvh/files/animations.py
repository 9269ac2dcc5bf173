"""Animations: GIF by Pillow, and MP4 by ffmpeg."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import closing
from functools import partial
from itertools import chain
from numbers import Real
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..choices import DEFAULT_FRAME_RATE
from ..errors import ConfigError
from ..support.files import check_target, temporary_folder, write_atomically

ANIMATION_SUFFIXES = (".gif", ".mp4")

_MOST_FRAME_RATE = 1000.0

# GIF counts in these, and viewers slow down animations that are faster than two of them.
_GIF_TICK_MS, _LEAST_GIF_TICKS = 10, 2

_FOLDER_PREFIX = ".clbvh-video-"

# Constant rate factor of x264; 18 is taken for visually lossless.
_VIDEO_QUALITY = "18"

# The colours are converted and marked as those of HDTV, and the index stands first, for players on a web page.
_VIDEO_OPTIONS = [
    *("-crf", _VIDEO_QUALITY, "-vf", "scale=out_color_matrix=bt709:out_range=tv"),
    *("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-movflags", "+faststart"),
]

_Frame = NDArray[np.uint8]


def check_animation(path: str | os.PathLike[str], frames_per_s: float) -> Path:
    """Return the path; raise `ConfigError` unless an animation can be written; for checks before the work begins."""
    path = check_target(path, "an animation", ANIMATION_SUFFIXES)
    if path.suffix.lower() == ".mp4":
        _import_ffmpeg()
    if isinstance(frames_per_s, bool) or not isinstance(frames_per_s, Real) or not 0 < frames_per_s <= _MOST_FRAME_RATE:
        raise ConfigError(f"frames_per_s must be above 0 and at most {_MOST_FRAME_RATE:g}, not {frames_per_s!r}")
    return path


def write_animation(path: Path, frames: Iterable[_Frame], frames_per_s: float = DEFAULT_FRAME_RATE) -> None:
    """Write frames, (height, width, 3) uint8 of one size, to a path that `check_animation` has accepted.

    The file appears when it is complete: an error in between, or Ctrl-C, leaves nothing behind. A frame of a GIF has
    256 colours. H.264 has colours of 2 x 2 pixels, so the last column and the last row are repeated where a side is
    odd.
    """
    write = _write_gif if path.suffix.lower() == ".gif" else partial(_write_mp4, parent=path.resolve().parent)
    write_atomically(path, lambda file: write(file, iter(frames), float(frames_per_s)))


def _write_gif(file: BinaryIO, frames: Iterator[_Frame], frames_per_s: float) -> None:
    from PIL import Image

    images = (Image.fromarray(frame) for frame in frames)
    ticks = max(_LEAST_GIF_TICKS, round(1000 / _GIF_TICK_MS / frames_per_s))
    first = next(images)
    first.save(file, format="GIF", save_all=True, append_images=images, duration=ticks * _GIF_TICK_MS, loop=0)


def _write_mp4(file: BinaryIO, frames: Iterator[_Frame], frames_per_s: float, parent: Path) -> None:
    ffmpeg = _import_ffmpeg()
    first = _pad_to_even(next(frames))
    height, width, _ = first.shape
    # ffmpeg writes to names only, and goes back in the file at its end. The folder of the result has room for it.
    with temporary_folder(parent, _FOLDER_PREFIX) as folder:
        video = folder / "video.mp4"
        writer = ffmpeg.write_frames(
            str(video), (width, height), fps=frames_per_s, codec="libx264", quality=None, macro_block_size=1,
            ffmpeg_log_level="error", output_params=_VIDEO_OPTIONS,
        )  # fmt: skip
        # Closing it waits for ffmpeg.
        with closing(writer):
            for frame in chain((None, first), map(_pad_to_even, frames)):
                writer.send(frame)
        if not video.is_file() or not video.stat().st_size:
            raise ConfigError(f"ffmpeg made no video of {width} x {height} pixels; it has said why")
        with video.open("rb") as made:
            shutil.copyfileobj(made, file)


def _pad_to_even(frame: _Frame) -> _Frame:
    """Return a frame with even sides: the last column and the last row are repeated where needed."""
    height, width, _ = frame.shape
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _import_ffmpeg() -> ModuleType:
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise ConfigError(f"MP4 files need imageio-ffmpeg: run 'pip install imageio-ffmpeg' ({error})") from error
    return imageio_ffmpeg
