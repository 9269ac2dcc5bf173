"""The samples of a study: one line of JSON for each, kept the moment it is taken, and read back by case.

A killed study loses at most the sample that it is taking. A line that was cut off is ignored, and so are samples of
another machine or version, which stay in the file.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from ..support.files import write_atomically
from .scale import Scale
from .statistics import Summary

FILE_NAME = "samples.jsonl"
TABLE_NAME = "samples.csv"

# The values that tell one row of an experiment's table from the others, such as {"mesh": "dragon", "workers": 2}.
Case = Mapping[str, Any]

_SAMPLE, _FAILURE, _DONE = "sample", "failure", "done"


@dataclass(frozen=True)
class Sample:
    """One measurement of a case.

    Attributes
    ----------
    values : dict of str to float
        Quantities by name; the name ends in the unit: ``build_ms``. Wall time and the device's event time have
        different names.
    facts : dict of str to str
        What is no number, such as the digest of a picture.
    """

    values: dict[str, float]
    facts: dict[str, str] = field(default_factory=dict)


class NotMeasuredError(Exception):
    """A case cannot be measured on this machine; the message says why, and stands on the page."""


def cross(**values: Iterable[Any]) -> list[Case]:
    """Return a case for each combination of the values of each key, equal values once."""
    return [dict(zip(values, row, strict=True)) for row in product(*map(dict.fromkeys, values.values()))]


def key_of(case: Case) -> str:
    """Return one text for equal cases."""
    return json.dumps(case, sort_keys=True)


class SampleFile:
    """The samples of one folder that were taken on one machine.

    Parameters
    ----------
    folder : Path
    machine : str
        The digest of the machine and its versions; other samples in the file are not seen.
    """

    def __init__(self, folder: Path, machine: str) -> None:
        self._path = folder / FILE_NAME
        self._machine = machine
        records = []
        for line in self._path.read_bytes().splitlines() if self._path.is_file() else ():
            with suppress(ValueError):
                records.append(json.loads(line))
        self._records = [record for record in records if record.get("machine") == machine]
        self.others = sum(record["kind"] == _SAMPLE for record in records if record.get("machine") != machine)

    def add_sample(self, experiment: str, case: Case, turn: int, sample: Sample, **context: Any) -> None:
        """Keep a sample; `context` is what else is known of its circumstances, such as the machine's load."""
        self._add(_SAMPLE, experiment, case=dict(case), round=turn, values=sample.values, facts=sample.facts, **context)

    def add_failure(self, experiment: str, case: Case, reason: str) -> None:
        """Keep the reason why a case has no samples."""
        self._add(_FAILURE, experiment, case=dict(case), reason=reason)

    def add_done(self, experiment: str, group: str, scale: str) -> None:
        """Keep that a group of cases has all the samples that a scale wants."""
        self._add(_DONE, experiment, group=group, scale=scale)

    def is_done(self, experiment: str, group: str, scale: str) -> bool:
        """Whether `add_done` was called for this group and scale."""
        return any(record["group"] == group and record["scale"] == scale for record in self._of(_DONE, experiment))

    def scales(self) -> set[str]:
        """Return the scales for which groups are done."""
        return {str(record["scale"]) for record in self._records if record["kind"] == _DONE}

    def samples(self, experiment: str) -> list[dict[str, Any]]:
        """Return the samples of an experiment as they stand in the file, in the order in which they were taken."""
        return self._of(_SAMPLE, experiment)

    def failures(self, experiment: str) -> list[dict[str, Any]]:
        """Return the cases without samples, and why: the last reason of each, unless it was measured later."""
        measured = {key_of(record["case"]) for record in self.samples(experiment)}
        latest = {key_of(record["case"]): record for record in self._of(_FAILURE, experiment)}
        return [record for key, record in latest.items() if key not in measured]

    def count(self, experiment: str, case: Case) -> int:
        """Return the number of samples of a case."""
        return sum(key_of(record["case"]) == key_of(case) for record in self.samples(experiment))

    def write_table(self) -> Path:
        """Write all samples as CSV, one line for each value, and return the path."""
        table = io.StringIO(newline="")
        writer = csv.writer(table)
        writer.writerow(["experiment", "case", "round", "quantity", "value"])
        for record in self._records:
            if record["kind"] == _SAMPLE:
                case = " ".join(f"{name}={value}" for name, value in record["case"].items())
                for item in {**record["values"], **record["facts"]}.items():
                    writer.writerow([record["experiment"], case, record["round"], *item])
        path = self._path.with_name(TABLE_NAME)
        write_atomically(path, lambda file: file.write(table.getvalue().encode()))
        return path

    def _of(self, kind: str, experiment: str) -> list[dict[str, Any]]:
        return [record for record in self._records if record["kind"] == kind and record["experiment"] == experiment]

    def _add(self, kind: str, experiment: str, **content: Any) -> None:
        line = json.dumps({"kind": kind, "experiment": experiment, "machine": self._machine, **content})
        with self._path.open("ab+") as file:
            file.seek(-1 if file.tell() else 0, os.SEEK_END)
            is_cut = file.read(1) not in (b"", b"\n")  # the line before was cut off by a kill
            file.write(b"\n" * is_cut + line.encode() + b"\n")
        # As it will be read back, so that a resumed study sees the same.
        self._records.append(json.loads(line))


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
        self, experiment: str, samples: SampleFile, scale: Scale, machine: dict[str, str], cases: list[Case] | None,
        pictures: Path,
    ) -> None:  # fmt: skip
        self.scale = scale
        self.machine = machine
        self.pictures = pictures
        failures = samples.failures(experiment)
        self._records: dict[str, list[dict[str, Any]]] = {}
        for record in samples.samples(experiment):
            self._records.setdefault(key_of(record["case"]), []).append(record)
        if cases is None:
            cases = [record["case"] for record in [*samples.samples(experiment), *failures]]
        by_key = {key_of(case): case for case in cases}
        self.cases = [case for key, case in by_key.items() if key in self._records]
        self.failures = [(record["case"], record["reason"]) for record in failures if key_of(record["case"]) in by_key]

    @property
    def cores(self) -> int:
        """The number of processors, and so of workers where nothing else is said."""
        return int(self.machine["cores"])

    @property
    def meshes(self) -> str:
        """The names of all meshes."""
        return ", ".join(self.distinct("mesh"))

    def find(self, **keys: Any) -> list[Case]:
        """Return the measured cases that have these values."""
        return [case for case in self.cases if all(case.get(name) == value for name, value in keys.items())]

    def by(self, name: str, **keys: Any) -> dict[Any, Case]:
        """Return the measured cases that have these values, by one more key."""
        return {case[name]: case for case in self.find(**keys)}

    def distinct(self, name: str) -> list[Any]:
        """Return the values of one key over the measured cases, in their order."""
        return list(dict.fromkeys(case[name] for case in self.cases if name in case))

    def values(self, case: Case | None, quantity: str) -> list[float]:
        """Return all samples of a quantity; none of no case."""
        records = [] if case is None else self._of(case)
        return [record["values"][quantity] for record in records if quantity in record["values"]]

    def summary(self, case: Case | None, quantity: str) -> Summary:
        """Return the summary of a quantity."""
        return Summary.of(self.values(case, quantity))

    def summaries(self, case: Case, *quantities: str) -> list[Summary]:
        """Return the summaries of some quantities."""
        return [self.summary(case, quantity) for quantity in quantities]

    def count(self, case: Case, quantity: str) -> int | None:
        """Return a quantity that is a whole number, None if it has no sample."""
        values = self.values(case, quantity)
        return int(values[0]) if values else None

    def ratio(self, over: Case | None, under: Case | None, quantity: str) -> Summary:
        """Return the summary of a ratio, round by round: the two were measured in turn."""
        pairs = zip(self.values(over, quantity), self.values(under, quantity), strict=False)
        return Summary.of([above / below for above, below in pairs if below])

    def quantities(self, case: Case, prefix: str) -> list[str]:
        """Return the names of the quantities with a prefix, without it."""
        names = dict.fromkeys(name for record in self._of(case) for name in record["values"] if name.startswith(prefix))
        return [name.removeprefix(prefix) for name in names]

    def fact(self, case: Case, name: str) -> str | None:
        """Return the latest fact of this name, None if there is none."""
        return next((record["facts"][name] for record in self._of(case)[::-1] if name in record["facts"]), None)

    def agree(self, cases: Iterable[Case], case: Case, name: str) -> str:
        """Return ``yes`` or ``NO``: whether a case has the same fact as the first of some cases."""
        return "yes" if self.fact(case, name) == self.fact(next(iter(cases)), name) else "NO"

    def picture(self, case: Case, name: str) -> list[bytes]:
        """Return the file of a picture whose name is a fact, nothing if there is none."""
        path = self.pictures / (self.fact(case, name) or "")
        return [path.read_bytes()] if path.is_file() else []

    @property
    def highest_load(self) -> float:
        """The highest load average at a sample, 0 where the system does not say."""
        return max((record.get("load") or 0.0 for case in self.cases for record in self._of(case)), default=0.0)

    def _of(self, case: Case) -> list[dict[str, Any]]:
        return self._records.get(key_of(case), [])
