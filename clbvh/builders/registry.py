"""The builders by their names: the default one in three qualities, and the variants of the ladder."""

from __future__ import annotations

from collections.abc import Callable

from ..bvh import Bvh
from ..errors import ConfigError
from ..geometry import Mesh
from .executor import Executor
from .ladder.variants import VARIANTS
from .options import DEFAULT_QUALITY, FAST_QUALITY, HIGH_QUALITY, BuildOptions
from .sah.build_sah import build_sah

DEFAULT_BUILDER = "sah"

Builder = Callable[[Mesh, Executor, BuildOptions], Bvh]

BUILDERS = (DEFAULT_BUILDER, *VARIANTS)


def find_builder(name: str, options: BuildOptions) -> Builder:
    """Return the function behind a builder's name; raise `ConfigError` as `check_builder` does."""
    check_builder(name, options)
    # A program needs one of them; the others are imported when they are asked for.
    if name in VARIANTS:
        from .ladder.build_variant import LADDER

        return LADDER[name]
    if options.quality == FAST_QUALITY:
        from .hlbvh import build_hlbvh

        return build_hlbvh
    if options.quality == HIGH_QUALITY:
        from .reinsertion.build_high import build_high

        return build_high
    return build_sah


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
    """Return the largest number of primitives in a leaf of this builder's trees."""
    return VARIANTS[builder].leaf_size(options) if builder in VARIANTS else options.leaf_size
