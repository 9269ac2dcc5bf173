"""Sizes of work-groups and tiles for the launches on a device."""

from __future__ import annotations

from dataclasses import dataclass

from .info import DeviceInfo

# GPUs run at least one whole warp or wavefront. On CPUs the rays of a work-group share an entry point, see
# cl/traversal/entry_point.cl: fewer rays make a narrower beam.
_WORK_GROUP_SIZE, _WORK_GROUP_SIZE_ON_CPU = 64, 32

# A square, whose rays visit similar nodes.
_TILE = (8, 8)


@dataclass(frozen=True)
class Settings:
    """The launch settings of one device.

    Attributes
    ----------
    work_group_size : int
        Work-items of a work-group, for arrays of rays that are no picture, and for points.
    tile : (int, int)
        Width and height of a work-group in pixels, for pictures and arrays of a picture's rays.
    """

    work_group_size: int = _WORK_GROUP_SIZE
    tile: tuple[int, int] = _TILE


def find_settings(info: DeviceInfo) -> Settings:
    """Return the settings that suit the kind of device."""
    return Settings(_WORK_GROUP_SIZE_ON_CPU if info.kind == "cpu" else _WORK_GROUP_SIZE)
