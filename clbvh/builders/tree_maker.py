"""The tree of a mesh: taken from the cache, built by workers, or built in this process.

Owns that decision and the workers' lifetime.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from numbers import Integral
from pathlib import Path
from types import TracebackType
from typing import ClassVar

from ..bvh import Bvh
from ..errors import ConfigError
from ..geometry import Mesh
from ..support.stopwatch import Stopwatch
from .build import build_tree
from .options import BuildOptions
from .registry import BUILDERS, DEFAULT_BUILDER, check_builder
from .subtree_pool import SubtreePool
from .tree_cache import cache_path, keep_tree, make_folder, take_tree
from .workers.pool import MAX_WORKERS

# Starting workers takes about half a second, which pays only for large meshes. From the start of two workers to the
# tree, against one process, on two cores with warm caches, medians of 3: 1.38 s against 1.22 s for 2,000,000 triangles,
# 1.64 s against 2.11 s for 4,000,000; loading hides a part of the start.
_POOL_PAYS_FROM = 2_000_000


@dataclass(frozen=True)
class TreeOptions:
    """The builder of a tree, its options, and the use of workers and cache.

    Attributes
    ----------
    builder : str
        A builder of `clbvh.build`.
    workers : int or None
        Processes that build; 1 builds in this process, and so needs no ``if __name__ == "__main__":`` in a script.
        None: one per processor for large meshes, else 1.
    build : BuildOptions
    cache : Path or None
        Folder in which trees are looked up and kept; None for no cache.
    """

    builder: str = DEFAULT_BUILDER
    workers: int | None = 1
    build: BuildOptions = field(default_factory=BuildOptions)
    cache: Path | None = None

    allowed_builders: ClassVar[tuple[str, ...]] = BUILDERS

    def __post_init__(self) -> None:
        check_builder(self.builder, self.build, self.allowed_builders)
        if self.workers is not None and not (isinstance(self.workers, Integral) and 1 <= self.workers <= MAX_WORKERS):
            raise ConfigError(f"workers must be 1 to {MAX_WORKERS}, not {self.workers!r}")
        if self.cache is not None and not isinstance(self.cache, Path):
            raise ConfigError(f"cache must be a pathlib.Path or None, not {self.cache!r}")


@dataclass(frozen=True, eq=False)
class MadeTree:
    """A tree and its origin.

    Attributes
    ----------
    bvh : Bvh
    workers : int
        Processes that built it; 0 for a tree from the cache.
    from_cache : bool
    timings_ms : dict of str to float
        pool_start (alongside other phases), cache, build.
    notes : tuple of str
        Facts that a user should know but that are no errors: a damaged file in the cache, or a full disk.
    """

    bvh: Bvh
    workers: int
    from_cache: bool
    timings_ms: dict[str, float]
    notes: tuple[str, ...] = ()


class TreeMaker:
    """Makes the tree of a mesh, and owns the workers that help.

    Make it before the mesh is loaded, so that the workers start meanwhile, and use it in a `with` block.

    Parameters
    ----------
    options : TreeOptions
    expected_face_count : int
        The approximate number of triangles.

    Raises
    ------
    ConfigError
        The folder of the cache cannot be created.
    """

    def __init__(self, options: TreeOptions, expected_face_count: int) -> None:
        self._options = options
        self._pool: SubtreePool | None = None
        self._stack = ExitStack()
        # With a cache it is not known yet whether the tree must be built.
        if options.cache is not None:
            make_folder(options.cache)
        else:
            self._start_pool(expected_face_count)

    def make(self, mesh: Mesh) -> MadeTree:
        """Return the tree of a mesh.

        Raises
        ------
        ConfigError, MeshError, PoolError
            See `clbvh.build`. A failing cache is no error, but a note.
        """
        options = self._options
        watch = Stopwatch()
        notes = []
        bvh, path = None, None
        if options.cache is not None:
            path = cache_path(options.cache, mesh, options.builder, options.build)
            bvh, note = take_tree(path, mesh)
            notes.append(note)
            watch.lap("cache")

        from_cache = bvh is not None
        if bvh is None:
            if path is not None:
                self._start_pool(mesh.face_count)
            bvh = build_tree(mesh, options.builder, self._pool, options.build)
            watch.lap("build")
            if path is not None:
                notes.append(keep_tree(path, bvh))
                watch.lap("cache")

        pool = self._pool
        timings_ms = {
            "pool_start": 0.0 if pool is None else pool.start_ms,
            "cache": watch.laps_ms.get("cache", 0.0),
            "build": watch.laps_ms.get("build", 0.0),
        }
        workers = 0 if from_cache else 1 if pool is None else pool.workers
        return MadeTree(bvh, workers, from_cache, timings_ms, tuple(filter(None, notes)))

    def __enter__(self) -> TreeMaker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def _start_pool(self, face_count: int) -> None:
        """Start the workers if the options ask for them, or the mesh is large enough."""
        workers = self._options.workers
        if workers != 1 and (workers is not None or face_count >= _POOL_PAYS_FROM):
            self._pool = self._stack.enter_context(SubtreePool(workers))
