"""The raw samples of a study: one line of JSON for each, kept the moment it is taken.

A killed study loses at most the sample that it is taking. A line that was cut off is ignored, and so are samples of
another machine or version, which stay in the file.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from ..support.atomic_file import write_atomically
from .case import Case, Sample, key_of

FILE_NAME = "samples.jsonl"
TABLE_NAME = "samples.csv"

_SAMPLE, _FAILURE, _DONE = "sample", "failure", "done"


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
        self._records: list[dict[str, Any]] = []
        self.others = 0
        for record in _read(self._path):
            if record.get("machine") == machine:
                self._records.append(record)
            else:
                self.others += record.get("kind") == _SAMPLE

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

    def scales(self, experiment: str) -> set[str]:
        """Return the scales for which groups of an experiment are done."""
        return {str(record["scale"]) for record in self._of(_DONE, experiment)}

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
        key = key_of(case)
        return sum(key_of(record["case"]) == key for record in self.samples(experiment))

    def write_table(self) -> Path:
        """Write all samples as CSV, one line for each value, and return the path."""
        path = self._path.with_name(TABLE_NAME)
        table = io.StringIO(newline="")
        writer = csv.writer(table)
        writer.writerow(["experiment", "case", "round", "quantity", "value"])
        for record in self._records:
            if record["kind"] == _SAMPLE:
                case = " ".join(f"{name}={value}" for name, value in record["case"].items())
                for quantity, value in {**record["values"], **record["facts"]}.items():
                    writer.writerow([record["experiment"], case, record["round"], quantity, value])
        write_atomically(path, lambda file: file.write(table.getvalue().encode()))
        return path

    def _of(self, kind: str, experiment: str) -> list[dict[str, Any]]:
        return [record for record in self._records if record["kind"] == kind and record["experiment"] == experiment]

    def _add(self, kind: str, experiment: str, **content: Any) -> None:
        record = {"kind": kind, "experiment": experiment, "machine": self._machine, **content}
        line = json.dumps(record).encode() + b"\n"
        with self._path.open("ab") as file:
            if file.tell() and not _ends_with_newline(self._path):
                # The line before was cut off by a kill.
                line = b"\n" + line
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        # As it will be read back, so that a resumed study sees the same.
        self._records.append(json.loads(line))


def _read(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the complete lines of a file."""
    lines: Iterable[bytes] = path.read_bytes().splitlines() if path.is_file() else ()
    for line in lines:
        try:
            record = json.loads(line)
        except ValueError:
            continue
        if isinstance(record, dict) and {"kind", "experiment"} <= record.keys():
            yield record


def _ends_with_newline(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"
