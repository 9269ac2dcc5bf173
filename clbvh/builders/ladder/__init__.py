"""The builders of the report, variant by variant, to measure what each of its ideas bought."""

from typing import TYPE_CHECKING

from ...support.lazy_imports import import_on_use

if TYPE_CHECKING:
    from .build_variant import DEFAULT_BINS, LADDER
    from .variants import VARIANTS, Variant

__all__ = ["DEFAULT_BINS", "LADDER", "VARIANTS", "Variant"]

# The names of the variants are known to programs that never build one.
__getattr__ = import_on_use(
    __name__,
    {"DEFAULT_BINS": "build_variant", "LADDER": "build_variant", "VARIANTS": "variants", "Variant": "variants"},
)
