"""The limit of the builder ``"brute"``, without which a picture would take forever."""

from __future__ import annotations

from ..errors import ConfigError

# The cost is rays times primitives: with more of them than this, a picture would take hours.
BRUTE_LIMIT = 100_000


def check_brute_limit(count: int, primitives: str) -> None:
    """Raise `ConfigError` if there are too many `primitives`, a plural, for a picture without a tree."""
    if count > BRUTE_LIMIT:
        raise ConfigError(
            f"the brute builder tests every primitive for every ray: {count:,} {primitives} are more than its limit of "
            f"{BRUTE_LIMIT:,}"
        )
