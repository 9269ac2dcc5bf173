"""The options of a build: one plain struct, every field with its effect."""

from __future__ import annotations

from dataclasses import dataclass

from ..choices import MAX_BINS, MAX_LEAF_SIZE
from ..errors import ConfigError
from ..support.settings import check_settings, number, one_of, setting, whole

MIN_BINS = 2
MIN_FRONTIER = 4
MAX_FRONTIER = 8192
_MOST = 2**31 - 1
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
    clbvh.errors.ConfigError: leaf_size must be a whole number from 1 to 255, not 0
    """

    bins: int | None = setting(
        None, "Bins per axis among which a split is looked for.", whole(MIN_BINS, MAX_BINS),
        shown="16 of sah, 8 of the report's builders",
    )  # fmt: skip
    leaf_size: int = setting(
        4, "Most primitives in a leaf. Less: more nodes and fewer triangle tests.", whole(1, MAX_LEAF_SIZE)
    )
    traversal_cost: float = setting(1.0, "Cost of a node step in triangle tests. More: fuller leaves.", number(above=0))
    task_threshold: int | None = setting(
        None, "Most primitives in a task of one worker. The tree does not depend on it.", whole(1, _MOST),
        shown="by the size of the mesh",
    )  # fmt: skip
    frontier: int = setting(64, "Most primitives in a leaf of the builder frontier.", whole(MIN_FRONTIER, MAX_FRONTIER))
    quality: str = setting(
        DEFAULT_QUALITY,
        "Quality of the builder sah. fast: built on the device, for few rays; high: rearranged, for many.",
        one_of(QUALITIES),
    )

    def __post_init__(self) -> None:
        check_settings(self, error=ConfigError)


WORKERS = whole(1, MAX_WORKERS)


def check_workers(workers: int | None) -> None:
    """Raise `ConfigError` unless this is a number of workers, or None."""
    if workers is not None:
        WORKERS.take("workers", workers, ", or None", ConfigError)
