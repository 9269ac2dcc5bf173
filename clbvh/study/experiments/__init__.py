"""The experiments by their names, in the order of the page."""

from __future__ import annotations

from collections.abc import Sequence

from ...errors import ConfigError
from ..experiment import Experiment
from .builders import Counters, Ladder, Scaling, Threshold, Trees
from .devices import Devices, Divergence, Layouts
from .frames import Breakdown, Frontier, Gallery, Resolution, Scenes
from .peers import Peers

EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment
    for experiment in (Ladder(), Trees(), Scaling(), Threshold(), Scenes(), Resolution(), Breakdown(), Frontier(),
                       Layouts(), Divergence(), Counters(), Peers(), Devices(), Gallery())
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
