"""The experiments by their names, in the order of the page."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import ConfigError
from .case import Experiment
from .experiments import (
    breakdown,
    counters,
    devices,
    divergence,
    frontier,
    gallery,
    ladder,
    layouts,
    peers,
    resolution,
    scaling,
    scenes,
    threshold,
)

EXPERIMENTS: dict[str, Experiment] = {
    module.EXPERIMENT.name: module.EXPERIMENT
    for module in (
        ladder, scaling, threshold, scenes, resolution, breakdown, frontier, layouts, divergence, counters, peers,
        devices, gallery,
    )
}  # fmt: skip


def find_experiments(names: Sequence[str]) -> list[Experiment]:
    """Return the experiments of these names, all without any, in the order of the page.

    Raises
    ------
    ConfigError
        There is no such experiment.
    """
    for name in names:
        if name not in EXPERIMENTS:
            raise ConfigError(f"there is no experiment '{name}': take one of {', '.join(EXPERIMENTS)}")
    return [experiment for name, experiment in EXPERIMENTS.items() if not names or name in names]
