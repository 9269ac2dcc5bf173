"""The tables of mutants fit the code; `make mutants` is the test of the tests."""

from __future__ import annotations

from collections import Counter

import pytest

from .laboratory import FAILED, PASSED, Laboratory
from .table import ROOT, Mutant, read_mutants

MUTANTS = read_mutants()
LEAST_IN_ALL = 300
LEAST = {
    "kernels": 60, "trees": 40, "rays": 40, "scene": 12, "loading": 12, "views": 12, "film": 12, "integrations": 12,
}  # fmt: skip


def test_rows_change_one_place_and_name_tests():
    for mutant in MUTANTS:
        assert mutant.occurrences() == 1, mutant
        assert mutant.text != mutant.replacement, mutant
        assert mutant.breaks, mutant
        assert mutant.tests, mutant
        for test in mutant.tests:
            assert (ROOT / test.split("::")[0]).is_file(), mutant


def test_no_fault_is_planted_twice():
    assert len({(mutant.file, mutant.text, mutant.replacement) for mutant in MUTANTS}) == len(MUTANTS)


def test_there_are_faults_everywhere():
    counts = Counter(mutant.name.split("-")[0] for mutant in MUTANTS)
    assert len(MUTANTS) >= LEAST_IN_ALL
    for table, least in LEAST.items():
        assert counts[table] >= least, table


# Each fault, and the result of a test that expects the file as it is.
RESULTS = {
    "return 2": FAILED,
    "return 1  # as before": PASSED,
    "return (": "pytest ended with 2",
    "raise KernelBuildError": "the code does not compile (KernelBuildError)",
}


@pytest.mark.parametrize("replacement", RESULTS)
def test_only_a_test_that_fails_catches(tmp_path, monkeypatch, replacement):
    root = tmp_path / "root"
    sources = {
        "pyproject.toml": "[tool.pytest.ini_options]\n",
        "clbvh/__init__.py": "KernelBuildError = ValueError('KernelBuildError')\n",
        "clbvh/one.py": "from clbvh import KernelBuildError\ndef one():\n    return 1\n",
        "tests/__init__.py": "",
        "tests/test_one.py": "from clbvh.one import one\ndef test_one():\n    assert one() == 1\n",
    }
    for name, text in sources.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    for module in ("table", "laboratory"):
        monkeypatch.setattr(f"tests.mutants.{module}.ROOT", root)
    monkeypatch.setattr("tests.mutants.laboratory._PARTS", ("clbvh", "tests", "pyproject.toml"))
    laboratory = Laboratory(tmp_path / "copy")
    mutant = Mutant("one-1", "clbvh/one.py", "return 1", replacement, "the number", ("tests/test_one.py",))
    assert laboratory.test(mutant.tests, mutant)[0] == RESULTS[replacement]
    assert (tmp_path / "copy/clbvh/one.py").read_text() == sources["clbvh/one.py"]
