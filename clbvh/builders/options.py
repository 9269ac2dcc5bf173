"""The options of a build: one plain struct, every field with its effect."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real

from ..choices import MAX_BINS, MAX_LEAF_SIZE
from ..errors import ConfigError

MIN_BINS = 2
MIN_FRONTIER = 4
MAX_FRONTIER = 8192
MAX_WORKERS = 1024  # a slip of the keyboard must not start a hundred thousand
DEFAULT_BUILDER = "sah"
DEFAULT_QUALITY = "default"
FAST_QUALITY = "fast"
HIGH_QUALITY = "high"
QUALITIES = (FAST_QUALITY, DEFAULT_QUALITY, HIGH_QUALITY)


@dataclass(frozen=True)
class BuildOptions:
    """How to build a tree.

    Attributes
    ----------
    bins : int or None
        Bins per axis among which a split is looked for, 2 to 64. More find slightly better splits and take longer.
        By default the builder's own number, 16 for `sah` and the report's 8 for the ladder.
    leaf_size : int
        Largest number of primitives in a leaf, 1 to 255. Smaller leaves mean more nodes and fewer triangle tests.
    traversal_cost : float
        Cost of one node step in units of one triangle test, above 0. Higher values make fuller leaves.
    task_threshold : int or None
        Ranges of at most this many primitives become one worker's task; larger ones are split by all workers
        together. By default it is chosen from the mesh size and the worker count. The tree does not depend on it.
    frontier : int
        Largest number of primitives in a leaf of the builder `frontier`, in place of `leaf_size`, 4 to 8192.
    quality : str
        The quality of the builder `sah`: ``"fast"``, a tree that the OpenCL device builds, for meshes of few queries,
        with a SAH cost up to 15 % higher; ``"default"``; ``"high"``, which rearranges that tree in about ten times its
        time, for scenes that are traced for long. Other builders have ``"default"`` only. See docs/build.md.

    Examples
    --------
    >>> import clbvh
    >>> options = clbvh.BuildOptions(leaf_size=8, quality="fast")
    >>> picture = clbvh.render("terrain", options=clbvh.RenderOptions(build=options))
    >>> clbvh.BuildOptions(leaf_size=0)
    Traceback (most recent call last):
    clbvh.errors.ConfigError: leaf_size must be 1 to 255, not 0
    """

    bins: int | None = None
    leaf_size: int = 4
    traversal_cost: float = 1.0
    task_threshold: int | None = None
    frontier: int = 64
    quality: str = DEFAULT_QUALITY

    def __post_init__(self) -> None:
        for name in ("bins", "leaf_size", "task_threshold", "frontier"):
            value = getattr(self, name)
            if value is None and name in ("bins", "task_threshold"):
                continue
            if isinstance(value, bool) or not isinstance(value, Integral):
                raise ConfigError(f"{name} must be a whole number, not {value!r}")
            object.__setattr__(self, name, int(value))
        if isinstance(self.traversal_cost, bool) or not isinstance(self.traversal_cost, Real):
            raise ConfigError(f"traversal_cost must be a number, not {self.traversal_cost!r}")
        object.__setattr__(self, "traversal_cost", float(self.traversal_cost))

        if self.quality not in QUALITIES:
            raise ConfigError(f"quality must be one of {', '.join(QUALITIES)}, not {self.quality!r}")
        if self.bins is not None and not MIN_BINS <= self.bins <= MAX_BINS:
            raise ConfigError(f"bins must be {MIN_BINS} to {MAX_BINS}, not {self.bins}")
        if not 1 <= self.leaf_size <= MAX_LEAF_SIZE:
            raise ConfigError(f"leaf_size must be 1 to {MAX_LEAF_SIZE}, not {self.leaf_size}")
        # Written so that NaN fails.
        if not 0 < self.traversal_cost < float("inf"):
            raise ConfigError(f"traversal_cost must be a finite number above 0, not {self.traversal_cost}")
        if self.task_threshold is not None and self.task_threshold < 1:
            raise ConfigError(f"task_threshold must be at least 1, not {self.task_threshold}")
        if not MIN_FRONTIER <= self.frontier <= MAX_FRONTIER:
            raise ConfigError(f"frontier must be {MIN_FRONTIER} to {MAX_FRONTIER}, not {self.frontier}")


def check_workers(workers: int | None) -> None:
    """Raise `ConfigError` unless this is a number of workers, or None."""
    if workers is not None and (isinstance(workers, bool) or not isinstance(workers, Integral)):
        raise ConfigError(f"workers must be a whole number, not {workers!r}")
    if workers is not None and not 1 <= workers <= MAX_WORKERS:
        raise ConfigError(f"workers must be 1 to {MAX_WORKERS}, not {workers}")
