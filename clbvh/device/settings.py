"""The launch settings of a device: by rule, or as `clbvh tune` measured them.

Owns the files of measured settings, one per device, version of its driver and version of clbvh; one that cannot be read
is ignored.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..support.files import write_atomically
from ..support.folders import __version__, find_cache
from .info import DeviceInfo

# GPUs run at least one whole warp or wavefront. On CPUs the rays of a work-group share an entry point, see
# cl/traversal/entry_point.cl: fewer rays make a narrower beam.
_WORK_GROUP_SIZE, _WORK_GROUP_SIZE_ON_CPU = 64, 32

# A square, whose rays visit similar nodes.
_TILE = (8, 8)

# Hexadecimal digits in a file's name.
_DIGITS = 16


@dataclass(frozen=True)
class Settings:
    """The launch settings of one device.

    Attributes
    ----------
    layout : str
        The layout for ``"auto"``.
    work_group_size : int
        Work-items of a work-group, for arrays of rays that are no picture, and for points.
    tile : (int, int)
        Width and height of a work-group in pixels, for pictures and arrays of a picture's rays.
    is_measured : bool
        Whether `clbvh tune` measured them.
    measured_ms : float or None
        The time of the kernels of `clbvh tune` with these settings, the same work on every device; orders the drivers
        of one processor.
    """

    layout: str
    work_group_size: int = _WORK_GROUP_SIZE
    tile: tuple[int, int] = _TILE
    is_measured: bool = False
    measured_ms: float | None = None


def default_settings(info: DeviceInfo) -> Settings:
    """Return the settings that suit the kind of device; no file is read."""
    return Settings(info.layout, _WORK_GROUP_SIZE_ON_CPU if info.kind == "cpu" else _WORK_GROUP_SIZE)


def find_settings(info: DeviceInfo) -> Settings:
    """Return the settings measured on the device, or else those that suit its kind; for a session that opens."""
    try:
        kept = json.loads(settings_path(info).read_text())
        columns, rows = kept["tile"]
        return Settings(kept["layout"], kept["work_group_size"], (columns, rows), True, kept["measured_ms"])
    except (OSError, ValueError, KeyError, TypeError):  # nothing was measured, or the file is damaged
        return default_settings(info)


def keep_settings(info: DeviceInfo, settings: Settings) -> Path:
    """Write measured settings of a device into the user's cache, and return the path.

    Raises
    ------
    ConfigError
        The folder cannot be created or written to.
    """
    path = settings_path(info)
    facts = _identity(info) | {name: value for name, value in asdict(settings).items() if name != "is_measured"}
    text = json.dumps(facts, indent=2) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, lambda file: file.write(text.encode()))
    except OSError as error:
        raise ConfigError(f"{path}: the measured settings cannot be kept: {error.strerror or error}") from error
    return path


def settings_path(info: DeviceInfo) -> Path:
    """Return the path for a device, its driver's version and the version of clbvh."""
    digest = hashlib.sha256(json.dumps(_identity(info), sort_keys=True).encode()).hexdigest()
    return find_cache() / "tuned" / f"{digest[:_DIGITS]}.json"


def _identity(info: DeviceInfo) -> dict[str, Any]:
    return {
        "device": info.name,
        "platform": info.platform,
        "platform_version": info.platform_version,
        "driver_version": info.driver_version,
        "clbvh": __version__,
    }
