"""How much random tests try: the short profile for every run, the long one for `make test-long`.

The examples of a short run follow from a test's code alone, so that a failure comes again. A long one tries many more,
from random seeds: the run's seed stands at the top of the report, and a failing example is printed to be pasted.
"""

import random
from typing import Any

from hypothesis import HealthCheck, settings

SHORT, LONG = "short", "long"

# A long run takes this many times as many seeds as a short one.
SEED_FACTOR = 10

# Compiling and a busy machine make single examples slow; nothing is written to disk.
_shared = settings(database=None, deadline=None, print_blob=True, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile(SHORT, _shared, derandomize=True)
settings.register_profile(LONG, _shared, derandomize=False)


class RunSeed:
    """The seed that all random numbers of a long run follow from."""

    value = 0


def is_long() -> bool:
    """Tell whether this run takes its time; known once pytest is configured."""
    return not settings.default.derandomize


def examples(*, short: int, long: int, **more: Any) -> settings:
    """Return the decorator of a property that is tried on this many examples, by profile; `more` are its settings."""
    return settings(max_examples=long if is_long() else short, **more)


def seeds(count: int) -> list[int]:
    """Return seeds for `parametrize`: 0 to `count` - 1 in a short run, random ones as well in a long one."""
    fixed = list(range(count))
    if not is_long():
        return fixed
    generator = random.Random(RunSeed.value)
    return fixed + [generator.randrange(count, 2**32) for _ in range((SEED_FACTOR - 1) * count)]
