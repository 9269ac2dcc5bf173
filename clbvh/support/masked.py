"""Arrays of `numpy.ma`, whose masked values are no numbers, though `numpy.asarray` gives some."""

from __future__ import annotations

import sys


def has_masked_values(values: object) -> bool:
    """Return whether a value is an array of `numpy.ma` with masked values; does not import that module."""
    module = sys.modules.get("numpy.ma")
    return (
        module is not None and isinstance(values, getattr(module, "MaskedArray", ())) and bool(module.is_masked(values))
    )
