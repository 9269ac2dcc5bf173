"""A mesh becomes a tree: the builders by their names."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import ConfigError
from ..geometry import Mesh
from ..tree import Bvh
from .ladder import LADDER, RUNGS
from .morton import build_fast
from .optimise import build_high
from .options import DEFAULT_QUALITY, FAST_QUALITY, HIGH_QUALITY, BuildOptions
from .pool import SubtreePool
from .sah import build_sah

DEFAULT_BUILDER = "sah"

_Builder = Callable[[Mesh, SubtreePool | None, BuildOptions], Bvh]

# What the default builder does for each of `options.QUALITIES`.
_QUALITIES: dict[str, _Builder] = {
    FAST_QUALITY: build_fast,
    DEFAULT_QUALITY: build_sah,
    HIGH_QUALITY: build_high,
}

BUILDERS = (DEFAULT_BUILDER, *LADDER)


def build(
    mesh: Mesh,
    *,
    pool: SubtreePool | None = None,
    builder: str = DEFAULT_BUILDER,
    bins: int | None = BuildOptions.bins,
    leaf_size: int = BuildOptions.leaf_size,
    traversal_cost: float = BuildOptions.traversal_cost,
    task_threshold: int | None = BuildOptions.task_threshold,
    frontier: int = BuildOptions.frontier,
    quality: str = BuildOptions.quality,
) -> Bvh:
    """Build a bounding volume hierarchy over a mesh.

    Parameters
    ----------
    mesh : Mesh
    pool : SubtreePool, optional
        Worker processes that share the work. Without one the calling process builds; the default builder does so for
        small meshes too.
    builder : str, optional
        ``"sah"``: binned surface area heuristic on three axes, parallel from the root. Or a rung of the report's
        ladder, see `docs/ladder.md`: ``"sequential"``, ``"naive"``, ``"range"``, ``"cached"``, ``"median"``,
        ``"bin"``, ``"atomic"``, ``"flatten"``, ``"flat"``, ``"frontier"``.
    bins, leaf_size, traversal_cost, task_threshold, frontier, quality : optional
        See `clbvh.BuildOptions`. A builder heeds those that it has a use for; a quality that it does not have is
        refused.

    Returns
    -------
    Bvh
        The same bytes for any pool and any threshold. No leaf lies deeper than 64.

    Raises
    ------
    ConfigError
        An option outside its range, an unknown builder, or a quality that it does not have.
    MeshError
        A mesh wider than about 1.7e38 units: distances between doubled centroids do not fit float32.
    PoolError
        A worker failed or died, or there is not enough memory to share.
    """
    options = BuildOptions(bins, leaf_size, traversal_cost, task_threshold, frontier, quality)
    return build_tree(mesh, builder, pool, options)


def build_tree(mesh: Mesh, builder: str, pool: SubtreePool | None, options: BuildOptions) -> Bvh:
    """Do what `build` does, with the options in one struct."""
    check_builder(builder, options)
    build_here = LADDER[builder] if builder in LADDER else _QUALITIES[options.quality]
    return build_here(mesh, pool, options)


def check_builder(builder: str, options: BuildOptions, allowed: tuple[str, ...] = BUILDERS) -> None:
    """Raise `ConfigError` for an unknown builder, and for a quality that it does not have."""
    if builder not in allowed:
        raise ConfigError(f"builder must be one of {', '.join(allowed)}, not '{builder}'")
    if builder != DEFAULT_BUILDER and options.quality != DEFAULT_QUALITY:
        raise ConfigError(
            f"the builder {builder} has one quality, {DEFAULT_QUALITY}: leave '{options.quality}' out, or take the "
            f"builder {DEFAULT_BUILDER}"
        )


def leaf_limit(builder: str, options: BuildOptions) -> int:
    """Return how many primitives a leaf of this builder's trees holds at most."""
    return RUNGS[builder].leaf_size(options) if builder in RUNGS else options.leaf_size
