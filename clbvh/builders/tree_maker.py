"""How a mesh gets its tree: built here, built by workers, or taken from the cache."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import ClassVar

from ..build import BuildOptions, SubtreePool
from ..build.builder import BUILDERS, DEFAULT_BUILDER, build_tree, check_builder
from ..errors import ConfigError
from ..geometry import Mesh
from ..stopwatch import Stopwatch
from ..tree import Bvh
from .tree_cache import cache_path, keep_tree, make_folder, take_tree

# Starting workers takes about half a second, which only large meshes earn back. From the start of two workers to the
# tree, against one process, on two cores with the caches warm, medians of 3: 1.38 s against 1.22 s for 2,000,000
# triangles, 1.64 s against 2.11 s for 4,000,000; loading hides some of the start.
_POOL_PAYS_FROM = 2_000_000


@dataclass(frozen=True)
class TreeOptions:
    """How a mesh gets its tree.

    Attributes
    ----------
    builder : str
        A builder of `clbvh.build`.
    workers : int or None
        Processes that build; 1 builds in this process, and so needs no ``if __name__ == "__main__":`` in a script.
        None: as many as there are processors, for meshes that are worth it.
    build : BuildOptions
    cache : Path or None
        Folder in which trees are looked for and kept; None for neither.
    """

    builder: str = DEFAULT_BUILDER
    workers: int | None = 1
    build: BuildOptions = field(default_factory=BuildOptions)
    cache: Path | None = None

    allowed_builders: ClassVar[tuple[str, ...]] = BUILDERS

    def __post_init__(self) -> None:
        check_builder(self.builder, self.build, self.allowed_builders)
        if self.workers is not None and self.workers < 1:
            raise ConfigError(f"workers must be at least 1, not {self.workers}")


@dataclass(frozen=True, eq=False)
class MadeTree:
    """A tree and how it came about.

    Attributes
    ----------
    bvh : Bvh
    workers : int
        Processes that built it; 0 for a tree from the cache.
    from_cache : bool
    timings_ms : dict of str to float
        pool_start (overlaps with what is done before `TreeMaker.make`), cache, build.
    notes : tuple of str
        What a user should know and what is no error: a damaged file in the cache, or a full disk.
    """

    bvh: Bvh
    workers: int
    from_cache: bool
    timings_ms: dict[str, float]
    notes: tuple[str, ...] = ()


class TreeMaker:
    """Makes the tree of a mesh, and owns the workers that help.

    To be made before the mesh is loaded, so that the workers start meanwhile, and to be used in a `with` block.

    Parameters
    ----------
    options : TreeOptions
    expected_face_count : int
        About how many triangles there will be.

    Raises
    ------
    ConfigError
        The folder of the cache cannot be made.
    """

    def __init__(self, options: TreeOptions, expected_face_count: int) -> None:
        self._options = options
        self._pool: SubtreePool | None = None
        self._stack = ExitStack()
        # With a cache nobody knows yet whether there will be anything to build.
        if options.cache is not None:
            make_folder(options.cache)
        else:
            self._start_pool(expected_face_count)

    def make(self, mesh: Mesh) -> MadeTree:
        """Return the tree of a mesh.

        Raises
        ------
        ConfigError, MeshError, PoolError
            See `clbvh.build`. A cache that cannot be used is no error.
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
        """Start the workers, if the options want them and the mesh is worth it."""
        workers = self._options.workers
        if workers != 1 and (workers is not None or face_count >= _POOL_PAYS_FROM):
            self._pool = self._stack.enter_context(SubtreePool(workers))
