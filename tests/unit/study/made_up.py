"""An experiment without a mesh or a device, for tests of what surrounds experiments."""

from __future__ import annotations

from collections.abc import Callable

from clbvh.study.case import Experiment, Sample
from clbvh.study.machine import Machine
from clbvh.study.page.parts import Table

MACHINE = Machine({"processor": "abacus", "cores": "2", "system": "beads", "python": "3"}, (), None, "no device")


def make_experiment(measure: Callable[[dict], dict] = lambda case: {"wall_ms": 1.0}, **fields) -> Experiment:
    """Return an experiment of three cases in two groups; `measure` gets the case and returns the values."""

    def present(results):
        rows = [(case["name"], results.summary(case, "wall_ms")) for case in results.cases]
        return [Table("All cases.", ("case", "wall, ms"), rows)]

    return Experiment(**{
        "name": "madeup", "title": "Made up", "question": "Does it <work>?", "method": "By hand.",
        "cases": lambda scale: [{"mesh": "a", "name": "one"}, {"mesh": "a", "name": "two"}, {"mesh": "b", "name": "x"}],
        "measure": lambda bench, case: Sample(measure(case)),
        "present": present,
        **fields,
    })  # fmt: skip
