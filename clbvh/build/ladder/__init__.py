"""The builders of the report, rung by rung, to measure what each of its ideas bought."""

from .climb import DEFAULT_BINS, LADDER
from .rungs import RUNGS, Rung

__all__ = ["DEFAULT_BINS", "LADDER", "RUNGS", "Rung"]
