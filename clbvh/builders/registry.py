"""The builders by their names: the default one in three qualities, and the variants of the ladder."""

from __future__ import annotations

from collections.abc import Callable

from ..bvh import Bvh
from ..errors import ConfigError
from ..geometry import Mesh
from .hlbvh import build_hlbvh
from .ladder import LADDER, VARIANTS
from .options import DEFAULT_QUALITY, FAST_QUALITY, HIGH_QUALITY, BuildOptions
from .reinsertion.build_high import build_high
from .sah.build_sah import build_sah
from .subtree_pool import SubtreePool

DEFAULT_BUILDER = "sah"

Builder = Callable[[Mesh, SubtreePool | None, BuildOptions], Bvh]

# The default builder for each of `options.QUALITIES`.
_QUALITIES: dict[str, Builder] = {
    FAST_QUALITY: build_hlbvh,
    DEFAULT_QUALITY: build_sah,
    HIGH_QUALITY: build_high,
}

BUILDERS = (DEFAULT_BUILDER, *LADDER)


def find_builder(name: str, options: BuildOptions) -> Builder:
    """Return the function behind a builder's name; raise `ConfigError` as `check_builder` does."""
    check_builder(name, options)
    return LADDER[name] if name in LADDER else _QUALITIES[options.quality]


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
