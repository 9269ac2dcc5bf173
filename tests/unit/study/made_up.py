"""An experiment without a mesh or a device, for tests of what surrounds experiments."""

from __future__ import annotations

from collections.abc import Callable

from clbvh.study.experiment import Experiment
from clbvh.study.machine import Machine
from clbvh.study.page import Table
from clbvh.study.samples import Sample

MACHINE = Machine({"processor": "abacus", "cores": "2", "system": "beads", "python": "3"}, None, "no device")


def make_experiment(measure: Callable[[dict], dict] = lambda case: {"wall_ms": 1.0}, **fields) -> Experiment:
    """Return an experiment of three cases in two groups; `measure` gets the case and returns the values."""

    class MadeUp(Experiment):
        """Made up.

        Does it <work>?

        By hand.
        """

        def cases(self, scale):
            return [{"mesh": "a", "name": "one"}, {"mesh": "a", "name": "two"}, {"mesh": "b", "name": "x"}]

        def measure(self, bench, case):
            return Sample(measure(case))

        def present(self, results):
            rows = [(case["name"], results.summary(case, "wall_ms")) for case in results.cases]
            return [Table("All cases.", ("case", "wall, ms"), rows)]

    return type("MadeUp", (MadeUp,), {"__doc__": MadeUp.__doc__, **fields})()
