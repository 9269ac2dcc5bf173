"""The script behind `make conformance`: what it skips, what it counts, what it prints."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[3] / ".ci" / "compare_runtimes.py"


@pytest.fixture
def script(monkeypatch):
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("compare_runtimes", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    monkeypatch.setitem(sys.modules, "compare_runtimes", module)
    spec.loader.exec_module(module)
    return module


def test_a_runtime_that_is_not_there_is_skipped_with_what_it_needs(script, monkeypatch, capsys):
    missing = [replace(runtime, find_library=lambda: None) for runtime in script.RUNTIMES]
    monkeypatch.setattr(script, "RUNTIMES", missing)
    assert script.main(["rusticl"]) == 1  # nothing was compared
    assert "rusticl: skipped, needs mesa-opencl-icd" in capsys.readouterr().err


def test_an_unknown_runtime_is_refused(script, capsys):
    with pytest.raises(SystemExit) as ended:
        script.main(["beignet"])
    assert ended.value.code == 2
    assert "'beignet' is no runtime" in capsys.readouterr().err


def test_findings_of_the_simulator_are_counted(script):
    errors = "\nInvalid write of size 1 at global memory address 0x4\n\tKernel: any_hit\n\tEntity: Global(0,0,0)\n\n"
    assert script.count_findings(errors) == 1
    assert (
        script.count_findings("Write-write data race at global memory address 0x4\n\tKernel: any_hit\n" + errors) == 2
    )
    assert script.count_findings("clbvh: all is well\n") == 0


def test_the_planted_write_has_a_place(script):
    assert script._RIGHT_WRITE in (script.PROJECT / "cl" / script._PLANTED_KERNEL).read_text()


def test_a_runtime_without_a_driver_fails(script, tmp_path):
    gone = replace(script.RUNTIMES[1], find_library=lambda: tmp_path / "libgone.so")
    outcome = script.check_runtime(gone, tmp_path / "libgone.so")
    assert outcome.is_failure
    assert "no OpenCL device" in outcome.answer


def test_a_runtime_that_takes_too_long_fails(script):
    outcome = script.check_runtime(replace(script.RUNTIMES[0], time_limit_s=0.05), None)
    assert outcome.is_failure
    assert "no answer within 0.05 s" in outcome.answer
