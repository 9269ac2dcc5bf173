"""The choice of a builder and its options, of threads and of a cache. The command line derives its options from it.

So it can be imported without numpy: builders are imported when a choice is checked.
Apart from `options.py`, which `build.py` imports: a choice is checked by that.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ..errors import ConfigError
from ..support.settings import Kind, check_settings, only, setting
from .options import DEFAULT_BUILDER, WORKERS, BuildOptions

_BUILDER_HELP = (
    "sah, or a variant of the report's ladder: sequential, naive, range, cached, median, bin, atomic, flatten, flat or "
    "frontier; for pictures also brute: no tree."
)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_path(value: object) -> bool:
    return isinstance(value, Path)


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

    builder: str = setting(DEFAULT_BUILDER, _BUILDER_HELP, Kind("a name", only(_is_text)))
    workers: int | None = setting(None, "Threads that build, at most.", WORKERS, shown="one per usable processor")
    build: BuildOptions = field(default_factory=BuildOptions)
    cache: Path | None = setting(None, "Folder for trees.", Kind("a pathlib.Path", only(_is_path), takes_arrays=True))

    def __post_init__(self) -> None:
        from .build import check_builder

        check_settings(self, error=ConfigError)
        check_builder(self.builder, self.build, self._list_builders())

    @staticmethod
    def _list_builders() -> tuple[str, ...]:
        """Return the names of all builders."""
        from .build import BUILDERS

        return BUILDERS
