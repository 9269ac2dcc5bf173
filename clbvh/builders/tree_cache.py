"""The tree over a shape: built, or taken from a folder that keeps trees for later runs.

Owns that decision, the names of the files, one per shape and set of build options, and the size of them all: trees that
have not been used for the longest time go first. Their content, which is not trusted, belongs to `bvh.serialize`.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from ..bvh import Bvh
from ..errors import ConfigError, TreeFileError
from ..geometry import Shape
from ..support.folders import find_cache
from ..support.stopwatch import Stopwatch
from ..support.version import __version__
from .build import build_small_shapes, build_tree, choose_workers
from .options import FAST_QUALITY, BuildOptions
from .tree_options import TreeOptions

if TYPE_CHECKING:
    from ..device.info import DeviceInfo

SUFFIX = ".tree"

# The most that all trees in a folder take, in MiB, unless this variable says otherwise. A million triangles take about
# 15 MiB.
LIMIT_VARIABLE = "CLBVH_CACHE_MIB"
DEFAULT_LIMIT_MIB = 4096

_MIB = 1 << 20
_MOST_DIGITS = 12

# Hexadecimal digits in a file's name. Collisions do no harm: the file holds the whole fingerprint.
_MESH_DIGITS = 32
_RECIPE_DIGITS = 16


@dataclass(frozen=True, eq=False)
class BuildResult:
    """Trees and their origin.

    Attributes
    ----------
    bvhs : tuple of Bvh
    workers : int
        Threads that built one, at most; 0 for trees from the cache or from a device.
    from_cache : bool
        Whether all come from there.
    timings_ms : dict of str to float
        cache, build.
    notes : tuple of str
        Facts that a user should know but that are no errors: a damaged file in the cache, or a full disk.
    """

    bvhs: tuple[Bvh, ...]
    workers: int
    from_cache: bool
    timings_ms: dict[str, float]
    notes: tuple[str, ...] = ()

    @property
    def bvh(self) -> Bvh:
        """The first tree."""
        return self.bvhs[0]

    @classmethod
    def join(cls, results: Sequence[BuildResult]) -> Self:
        """Return the trees of several results, one after the other."""
        return cls(
            tuple(bvh for each in results for bvh in each.bvhs),
            max(each.workers for each in results),
            all(each.from_cache for each in results),
            {phase: sum(each.timings_ms[phase] for each in results) for phase in ("cache", "build")},
            tuple(dict.fromkeys(note for each in results for note in each.notes)),
        )


def get_tree(shape: Shape, options: TreeOptions, device: DeviceInfo | str | int | None = None) -> BuildResult:
    """Return the tree over a mesh or spheres, from the cache if it is there.

    Raises
    ------
    ConfigError, MeshError
        See `clbvh.build`; or the folder of the cache cannot be created. A failing cache is no error, but a note.
    """
    watch = Stopwatch()
    notes = []
    bvh, path = None, None
    if options.cache is not None:
        try:
            options.cache.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = error.strerror or error
            raise ConfigError(f"{options.cache}: trees cannot be kept in this folder: {reason}") from error
        path = cache_path(options.cache, shape, options.builder, options.build)
        bvh, note = take_tree(path, shape)
        notes.append(note)
        watch.lap("cache")

    workers, from_cache = 0, bvh is not None
    if bvh is None:
        on = None
        if options.build.quality == FAST_QUALITY:
            on = device
        else:
            workers = choose_workers(shape.prim_count, options.builder, options.build, options.workers)
        bvh = build_tree(shape, options.builder, None, options.build, options.workers, on)
        watch.lap("build")
        if path is not None:
            notes.append(keep_tree(path, bvh))
            watch.lap("cache")
    timings_ms = {phase: watch.laps_ms.get(phase, 0.0) for phase in ("cache", "build")}
    return BuildResult((bvh,), workers, from_cache, timings_ms, tuple(filter(None, notes)))


def get_trees(
    shapes: Sequence[Shape], find_options: Callable[[Shape], TreeOptions], device: DeviceInfo | str | int | None = None
) -> BuildResult:
    """Return the trees over shapes, as `get_tree` does with the options of each one.

    But those of many small shapes are in no cache: they are built in less time than files are opened.
    """
    watch = Stopwatch()
    if not shapes:
        return BuildResult((), 0, False, dict.fromkeys(("cache", "build"), 0.0))
    shared = find_options(shapes[0])
    small = build_small_shapes(shapes, shared.builder, lambda shape: find_options(shape).build, shared.workers)
    watch.lap("build")
    timings_ms = {"cache": 0.0, "build": watch.total_ms / max(1, len(small))}
    return BuildResult.join(
        [
            BuildResult((small[number],), 1, False, timings_ms)
            if number in small
            else get_tree(shape, find_options(shape), device)
            for number, shape in enumerate(shapes)
        ]
    )


def find_tree_cache() -> Path:
    """Return the folder for trees in the user's cache: in `CLBVH_CACHE`, or in the system's folder for caches."""
    return find_cache() / "trees"


def cache_path(folder: Path, shape: Shape, builder: str, options: BuildOptions) -> Path:
    """Return the path for the tree over a shape.

    The name identifies the shape, by its fingerprint, and everything that determines the tree: the builder, its options
    without the task threshold, and the version of clbvh.
    """
    recipe = dataclasses.asdict(options) | {"builder": builder, "version": __version__}
    del recipe["task_threshold"]
    digest = hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()
    return folder / f"{shape.fingerprint.hex()[:_MESH_DIGITS]}-{digest[:_RECIPE_DIGITS]}{SUFFIX}"


def take_tree(path: Path, shape: Shape) -> tuple[Bvh | None, str]:
    """Return the tree in a file, or None and the reason in one sentence, which is empty if there is no such file."""
    if not path.exists():
        return None, ""
    unusable = "the tree in the cache cannot be used and is built again"
    try:
        bvh = Bvh.load(path, shape)
    except TreeFileError as error:
        return None, f"{unusable}: {error}"
    with suppress(OSError):
        os.utime(path)  # used just now
    return bvh, ""


def keep_tree(path: Path, bvh: Bvh) -> str:
    """Write a tree into its file, and remove others until all fit the limit.

    Returns
    -------
    str
        The reason why the tree is not kept, in one sentence; empty if it is.
    """
    limit, note = _find_limit()
    try:
        bvh.save(path)
        size = path.stat().st_size
    except (OSError, ConfigError) as error:
        return f"the tree cannot be kept in the cache: {error}"
    if size > limit:
        path.unlink(missing_ok=True)
        return (
            f"the tree has {size / _MIB:,.1f} MiB and is not kept in the cache, which may have {limit / _MIB:g} MiB: "
            f"set {LIMIT_VARIABLE} to more"
        )
    _remove_oldest(path, limit - size)
    return note


def _find_limit() -> tuple[int, str]:
    """Return the limit in bytes, and a sentence if the user's cannot be used."""
    text = os.environ.get(LIMIT_VARIABLE, "").strip()
    if not text:
        return DEFAULT_LIMIT_MIB * _MIB, ""
    if text.isascii() and text.isdecimal() and len(text) <= _MOST_DIGITS:
        return int(text) * _MIB, ""
    note = f"{LIMIT_VARIABLE} must be a whole number of MiB, not {text!r}: the limit is {DEFAULT_LIMIT_MIB}"
    return DEFAULT_LIMIT_MIB * _MIB, note


def _remove_oldest(kept: Path, limit: int) -> None:
    """Remove the trees beside `kept` that were used the longest time ago, until the others have `limit` bytes."""
    trees = []
    for path in kept.parent.glob(f"*{SUFFIX}"):
        with suppress(OSError):  # another process removes some, too
            if path != kept:
                status = path.stat()
                trees.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in trees)
    for _, size, path in sorted(trees):
        if total <= limit:
            break
        with suppress(OSError):
            path.unlink()
        total -= size
