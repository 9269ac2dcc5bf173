"""How kernels are launched on a device: by rule, or as `clbvh tune` measured it there.

Owns the file that keeps what was measured, one for each device and version of its driver. A file that cannot be read,
or that says something impossible, is as good as none.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import ConfigError
from ..geometry.known import find_cache
from ..layout import LAYOUT_WIDTHS
from ..whole_file import write_whole

if TYPE_CHECKING:
    from .select import DeviceInfo

# A CPU's vector unit works inside a work-item, a GPU's across them.
_LAYOUT_OF_KIND = {"gpu": "bvh2", "accelerator": "bvh2", "cpu": "bvh8"}
_LAYOUT_OF_ANY = "bvh2"

# GPUs run at least one whole warp or wavefront. On CPUs the rays of a group begin together, see cl/entry.cl: the fewer
# they are, the narrower is their beam.
_GROUP_SIZE = 64
_GROUP_SIZE_OF_KIND = {"cpu": 32}

# A square, whose rays take similar paths.
_TILE = (8, 8)

# Hexadecimal digits in a file's name.
_DIGITS = 16

_LARGEST_GROUP = 1024


@dataclass(frozen=True)
class Settings:
    """How to launch kernels on one device.

    Attributes
    ----------
    layout : str
        What ``"auto"`` means.
    group_size : int
        Work-items of a work-group, for other rays in arrays, and for points.
    tile : (int, int)
        Columns and rows of a work-group, for pictures and for arrays of a picture's rays.
    is_measured : bool
        Whether this comes from `clbvh tune`.
    """

    layout: str
    group_size: int = _GROUP_SIZE
    tile: tuple[int, int] = _TILE
    is_measured: bool = False


def default_settings(info: DeviceInfo) -> Settings:
    """Return what suits the kind of device."""
    return Settings(_LAYOUT_OF_KIND.get(info.kind, _LAYOUT_OF_ANY), _GROUP_SIZE_OF_KIND.get(info.kind, _GROUP_SIZE))


def find_settings(info: DeviceInfo) -> Settings:
    """Return what was measured on the device, or else what suits its kind."""
    try:
        kept = json.loads(settings_path(info).read_text(encoding="utf-8"))
        return _check(kept)
    except (OSError, ValueError, KeyError, TypeError):
        return default_settings(info)


def keep_settings(info: DeviceInfo, settings: Settings) -> Path:
    """Write what was measured on a device into the user's cache, and return the file.

    Raises
    ------
    ConfigError
        The folder cannot be made, or written to.
    """
    path = settings_path(info)
    facts = _identity(info) | {name: value for name, value in asdict(settings).items() if name != "is_measured"}
    text = json.dumps(facts, indent=2) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, lambda file: file.write(text.encode()))
    except OSError as error:
        raise ConfigError(f"{path}: what was measured cannot be kept: {error.strerror or error}") from error
    return path


def settings_path(info: DeviceInfo) -> Path:
    """Return the file for a device: another driver, or another version of clbvh, has another one."""
    digest = hashlib.sha256(json.dumps(_identity(info), sort_keys=True).encode()).hexdigest()
    return find_cache() / "tuned" / f"{digest[:_DIGITS]}.json"


def _identity(info: DeviceInfo) -> dict[str, Any]:
    return {
        "device": info.name,
        "platform": info.platform,
        "platform_version": info.platform_version,
        "driver_version": info.driver_version,
        "clbvh": version("clbvh"),
    }


def _check(kept: dict[str, Any]) -> Settings:
    """Return settings that can be used; a `ValueError` says that these cannot."""
    columns, rows = map(int, kept["tile"])
    settings = Settings(str(kept["layout"]), int(kept["group_size"]), (columns, rows), is_measured=True)
    is_possible = (
        settings.layout in LAYOUT_WIDTHS
        and 1 <= settings.group_size <= _LARGEST_GROUP
        and min(settings.tile) >= 1
        and columns * rows <= _LARGEST_GROUP
    )
    if not is_possible:
        raise ValueError(f"no such settings: {settings}")
    return settings
