"""The samples of one experiment, as its page needs them."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

from .case import Case, key_of
from .sample_file import SampleFile
from .scale import Scale
from .statistics import Summary


class Results:
    """The samples of one experiment, by case.

    Parameters
    ----------
    experiment : str
    samples : SampleFile
    scale : Scale
        Cases of other scales in the same file are left out.
    machine : dict of str to str
        The facts of the machine on which the samples were taken.
    cases : list of Case, optional
        The cases of the scale, in the order of the table; without it all that have samples, in the order of these.
    pictures : Path
        The folder of the pictures.
    """

    def __init__(
        self,
        experiment: str,
        samples: SampleFile,
        scale: Scale,
        machine: dict[str, str],
        cases: list[Case] | None,
        pictures: Path,
    ) -> None:
        self.scale = scale
        self.machine = machine
        self.pictures = pictures
        self._records: dict[str, list[dict[str, Any]]] = {}
        for record in samples.samples(experiment):
            self._records.setdefault(key_of(record["case"]), []).append(record)
        if cases is None:
            cases = [record["case"] for record in [*samples.samples(experiment), *samples.failures(experiment)]]
            cases = list({key_of(case): case for case in cases}.values())
        self.cases = [case for case in cases if key_of(case) in self._records]
        wanted = {key_of(case) for case in cases}
        self.failures: list[tuple[Case, str]] = [
            (record["case"], record["reason"])
            for record in samples.failures(experiment)
            if key_of(record["case"]) in wanted
        ]

    @property
    def cores(self) -> int:
        """The number of processors, and so of workers where nothing else is said."""
        return int(self.machine["cores"])

    def find(self, **keys: str | int | float) -> list[Case]:
        """Return the measured cases that have these values."""
        return [case for case in self.cases if all(case.get(name) == value for name, value in keys.items())]

    def distinct(self, name: str) -> list[Any]:
        """Return the values of one key over the measured cases, in their order."""
        return list(dict.fromkeys(case[name] for case in self.cases if name in case))

    def values(self, case: Case, quantity: str) -> list[float]:
        """Return all samples of a quantity."""
        return [
            record["values"][quantity] for record in self._records.get(key_of(case), []) if quantity in record["values"]
        ]

    def summary(self, case: Case, quantity: str) -> Summary | None:
        """Return the summary of a quantity, None if it has no sample."""
        values = self.values(case, quantity)
        return Summary.of(values) if values else None

    def median(self, case: Case, quantity: str) -> float | None:
        """Return the median of a quantity, None if it has no sample."""
        values = self.values(case, quantity)
        return statistics.median(values) if values else None

    def ratio(self, over: Case, under: Case, quantity: str) -> Summary | None:
        """Return the summary of a ratio, round by round: the two were measured in turn."""
        pairs = zip(self.values(over, quantity), self.values(under, quantity), strict=False)
        ratios = [above / below for above, below in pairs if below]
        return Summary.of(ratios) if ratios else None

    def quantities(self, case: Case, prefix: str) -> list[str]:
        """Return the names of the quantities with a prefix, without it."""
        records = self._records.get(key_of(case), [])
        names = dict.fromkeys(name for record in records for name in record["values"] if name.startswith(prefix))
        return [name.removeprefix(prefix) for name in names]

    def fact(self, case: Case, name: str) -> str | None:
        """Return the latest fact of this name, None if there is none."""
        facts = [record["facts"][name] for record in self._records.get(key_of(case), []) if name in record["facts"]]
        return facts[-1] if facts else None

    @property
    def sample_count(self) -> int:
        """Samples of all cases."""
        return sum(len(self._records[key_of(case)]) for case in self.cases)

    @property
    def highest_load(self) -> float | None:
        """The highest load average at a sample, None where the system does not say."""
        loads = [record.get("load") for case in self.cases for record in self._records[key_of(case)]]
        return max((load for load in loads if load is not None), default=None)
