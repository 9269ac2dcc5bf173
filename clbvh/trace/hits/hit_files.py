"""Files of hits: numpy archives, written completely or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...geometry import Mesh
from ...support.files import check_target, write_atomically
from .hits import Hits

HITS_SUFFIX = ".npz"


def check_hits_path(path: Path) -> None:
    """Raise `ConfigError` unless hits can be written there."""
    check_target(path, "a hits file", (HITS_SUFFIX,))


def write_hits(path: Path, hits: Hits, geometry_names: Sequence[str], instance_names: Sequence[str]) -> None:
    """Write hits as a numpy archive, in which nothing is pickled.

    Parameters
    ----------
    path : Path
    hits : Hits
        Their t, u, v, prim_id, geometry_id and instance_id become arrays of these names, in the shape of the hits.
        Where meshes have parts, `part_names` are those of all of them, one mesh after the other, and `part_id` counts
        through them.
    geometry_names, instance_names : sequence of str
        By the ids; they become arrays of texts.

    Raises
    ------
    ConfigError
        The path has another suffix, or the file cannot be written.
    """
    check_hits_path(path)
    arrays = {
        **{name: getattr(hits, name) for name in ("t", "u", "v", "prim_id", "geometry_id", "instance_id")},
        "geometry_names": np.array(geometry_names, np.str_),
        "instance_names": np.array(instance_names, np.str_),
    }
    shapes = hits.surface.shapes if hits.surface else ()
    parts = [shape.parts if isinstance(shape, Mesh) else () for shape in shapes]
    if any(parts):
        part_id, first_parts = hits.part_id, np.cumsum([0, *map(len, parts)], dtype=np.int32)
        arrays["part_id"] = np.where(part_id < 0, np.int32(-1), part_id + first_parts[hits.geometry_id])
        arrays["part_names"] = np.array([part.name for own in parts for part in own], np.str_)
    write_atomically(path, lambda file: np.savez(file, **arrays))
