"""The choice of a builder and its options, of threads and of a cache. The command line derives its options from it.

So it can be imported without numpy: builders are imported when a choice is checked.
Apart from `options.py`, which `build.py` imports: a choice is checked by that.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ..errors import ConfigError
from .options import DEFAULT_BUILDER, BuildOptions, check_workers


@dataclass(frozen=True)
class TreeOptions:
    """The builder of a tree, its options, its threads and its cache.

    Attributes
    ----------
    builder : str
        ``"sah"``, or a variant of the report's ladder: ``"sequential"``, ``"naive"``, ``"range"``, ``"cached"``,
        ``"median"``, ``"bin"``, ``"atomic"``, ``"flatten"``, ``"flat"`` or ``"frontier"``; for pictures also
        ``"brute"``: no tree.
    workers : int or None
        Threads that build, at most; by default one per usable processor.
    build : BuildOptions
    cache : Path or None
        Folder in which trees are looked up and kept; None for no cache.
    """

    builder: str = DEFAULT_BUILDER
    workers: int | None = None
    build: BuildOptions = field(default_factory=BuildOptions)
    cache: Path | None = None

    def __post_init__(self) -> None:
        from .build import check_builder

        check_builder(self.builder, self.build, self._list_builders())
        check_workers(self.workers)
        if self.cache is not None and not isinstance(self.cache, Path):
            raise ConfigError(f"cache must be a pathlib.Path or None, not {self.cache!r}")

    @staticmethod
    def _list_builders() -> tuple[str, ...]:
        """Return the names of all builders."""
        from .build import BUILDERS

        return BUILDERS
