"""The experiments of the report, repeated on this machine, and the contest with other engines.

An experiment is a table of cases, a function that takes one sample of a case, and a function that arranges the samples
as tables and figures: one file each, in `experiments/`. Sampling, resuming, statistics, drawing and the page are
written once, beside it. Nothing here prints.
"""

from .experiments import EXPERIMENTS, find_experiments
from .run import Study, run_study

__all__ = ["EXPERIMENTS", "Study", "find_experiments", "run_study"]
