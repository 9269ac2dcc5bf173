"""Compares a device's answers with the stored ones: every layout, every query, byte by byte."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..builders.build import build
from ..device.info import DeviceInfo
from ..errors import ConfigError, ValidationError
from ..trace.device_tree import BRUTE
from .cases import Case, make_cases
from .expected import Expected, ExpectedAnswers, digest_of, load_expected
from .queries import ALL_LAYOUTS, Answer, answer_pictures, answer_rays


@dataclass(frozen=True)
class Difference:
    """A part of an answer that differs from what is stored.

    Attributes
    ----------
    layout, query, mesh, part : str
    row : int
        The first ray, point or pixel that differs; -1 if it cannot be told.
    value : str
        The device's answer there.
    """

    layout: str
    query: str
    mesh: str
    part: str
    row: int
    value: str

    def __str__(self) -> str:
        where = (
            f"first in row {self.row}, where it is {self.value}" if self.row >= 0 else "in a row that cannot be told"
        )
        return f"{self.layout}, {self.query}, mesh '{self.mesh}': {self.part} differs, {where}"


@dataclass(frozen=True)
class Conformance:
    """The result of a check.

    Attributes
    ----------
    device : DeviceInfo
    compared : dict of (layout, query) to int
        Number of parts that were compared.
    differences : tuple of Difference
    unusable : tuple of str
        Meshes whose rays or points have other bytes on this machine than where the answers were stored: nothing about
        them was compared.
    """

    device: DeviceInfo
    compared: dict[tuple[str, str], int]
    differences: tuple[Difference, ...]
    unusable: tuple[str, ...]

    @property
    def is_equal(self) -> bool:
        """Whether everything could be compared, and was equal."""
        return not self.differences and not self.unusable

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON has it."""
        return {
            "is_equal": self.is_equal,
            "compared": [
                {"layout": layout, "query": query, "parts": count} for (layout, query), count in self.compared.items()
            ],
            "differences": [dict(vars(difference)) for difference in self.differences],
            "unusable": list(self.unusable),
        }


def check_device(
    device: DeviceInfo,
    *,
    layouts: Sequence[str] = ALL_LAYOUTS,
    meshes: Sequence[str] = (),
    on_case: Callable[[str], None] = lambda case: None,
) -> Conformance:
    """Compare all answers of a device with the stored ones.

    Parameters
    ----------
    device : DeviceInfo
    layouts : sequence of str, optional
        Among `ALL_LAYOUTS`.
    meshes : sequence of str, optional
        Names of cases; all without it.
    on_case : function, optional
        Called with the mesh and the layout before they are checked.

    Raises
    ------
    DeviceError, KernelBuildError
        The device fails.
    ConfigError
        An unknown mesh.
    InternalError
        The stored answers are missing.
    """
    digests, expected = load_expected()
    unknown = sorted(set(meshes) - set(digests))
    if unknown:
        raise ConfigError(f"'{unknown[0]}' is no mesh of the conformance check: there are {', '.join(digests)}")
    compared: dict[tuple[str, str], int] = {}
    differences: list[Difference] = []
    unusable: list[str] = []
    for case in make_cases():
        if meshes and case.name not in meshes:
            continue
        if digests.get(case.name) != digest_of(case):
            unusable.append(case.name)
            continue
        for layout, query, answer in answer_case(case, device, layouts, on_case):
            stored = expected[case.name][query]
            key = layout, query
            compared[key] = compared.get(key, 0) + len(answer)
            differences += compare_answer(layout, query, case.name, answer, stored)
    return Conformance(device, compared, tuple(differences), tuple(unusable))


def answer_case(
    case: Case, device: DeviceInfo, layouts: Sequence[str], on_case: Callable[[str], None] = lambda case: None
) -> Iterator[tuple[str, str, Answer]]:
    """Yield layout, query and answer of everything that is asked about a case."""
    bvh = build(case.mesh)
    for layout in layouts:
        on_case(f"{case.name}, {layout}")
        if layout != BRUTE:
            for query, answer in answer_rays(case, bvh, layout, device):
                yield layout, query, answer
        for query, answer in answer_pictures(case, bvh, layout, device):
            yield layout, query, answer


def compare_answer(layout: str, query: str, mesh: str, answer: Answer, stored: dict[str, Expected]) -> list[Difference]:
    """Return the parts of an answer that are not the stored ones."""
    differences = []
    for part, values in answer.items():
        row = stored[part].find_difference(values)
        if row is not None:
            differences.append(Difference(layout, query, mesh, part, row, _show(values, row)))
    return differences


def collect_expected(cases: Sequence[Case], device: DeviceInfo) -> ExpectedAnswers:
    """Return what is to be stored, on which all layouts of a device must agree.

    Raises
    ------
    ValidationError
        Two layouts disagree.
    """
    answers: ExpectedAnswers = {}
    for case in cases:
        of_case = answers.setdefault(case.name, {})
        for layout, query, answer in answer_case(case, device, ALL_LAYOUTS):
            stored = of_case.setdefault(query, {part: Expected.of(values) for part, values in answer.items()})
            differences = compare_answer(layout, query, case.name, answer, stored)
            if differences:
                raise ValidationError(f"the layouts disagree, so nothing is stored: {differences[0]}")
    return answers


def _show(values: NDArray, row: int) -> str:
    """Return a row for a message, floats with all their digits."""
    return "" if row < 0 else np.array2string(values[row], precision=17, separator=", ", max_line_width=10_000)
