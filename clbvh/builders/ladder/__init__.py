"""The builders of the report, variant by variant, to measure what each of its ideas bought."""

from .build_variant import DEFAULT_BINS, LADDER
from .variants import VARIANTS, Variant

__all__ = ["DEFAULT_BINS", "LADDER", "VARIANTS", "Variant"]
