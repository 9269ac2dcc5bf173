"""`clbvh doctor --fix`: what it plans, tries, writes and removes."""

import pytest

from clbvh.device.doctor import drivers, register
from clbvh.device.doctor.drivers import KNOWN_DRIVERS, FoundLibrary
from clbvh.device.doctor.probe import ProbeResult
from clbvh.device.doctor.register import Step, carry_out, find_unregistered, plan_registrations, try_library
from clbvh.device.icd_files import IcdFile
from clbvh.errors import ConfigError

TIMEOUT_S = 60
INTEL = next(driver for driver in KNOWN_DRIVERS if driver.stem == "libintelocl.so")


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine on which Intel's library lies in no folder of the loader; returns the folder for its drivers."""
    for variable in ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("CLBVH_DRIVERS", str(tmp_path / "drivers"))
    library = tmp_path / "libintelocl.so"
    library.touch()
    monkeypatch.setattr(drivers, "find_libraries", lambda *_: [FoundLibrary(INTEL, library)])
    monkeypatch.setattr(register, "try_library", lambda *_: (["Xeon"], ""))
    return tmp_path / "drivers"


def test_a_driver_that_works_is_registered_once(machine, tmp_path):
    steps = plan_registrations(TIMEOUT_S)
    path = machine / "intel64.icd"
    assert steps == [Step("write", path, str(tmp_path / "libintelocl.so"), "Xeon")]
    assert not machine.exists()  # a plan writes nothing
    carry_out(steps)
    assert path.read_text() == f"{tmp_path}/libintelocl.so\n"
    assert [file.name for file in machine.iterdir()] == ["intel64.icd"]
    assert plan_registrations(TIMEOUT_S) == []


def test_a_driver_that_does_not_work_is_left_alone_with_the_reason(machine, monkeypatch):
    monkeypatch.setattr(register, "try_library", lambda *_: ([], "was killed by SIGSEGV"))
    (step,) = plan_registrations(TIMEOUT_S)
    assert (step.action, step.reason) == ("leave", "was killed by SIGSEGV")
    carry_out([step])
    assert not machine.exists()


def test_a_registration_whose_library_is_gone_is_removed_and_replaced(machine, tmp_path):
    machine.mkdir()
    (machine / "intel64.icd").write_text("/gone/libintelocl.so\n")
    (machine / "other.icd").write_text("/gone/libother.so\n")
    steps = plan_registrations(TIMEOUT_S)
    assert [(step.action, step.path.name) for step in steps] == [
        ("remove", "intel64.icd"),
        ("remove", "other.icd"),
        ("write", "intel64.icd"),
    ]
    carry_out(steps)
    assert [file.name for file in machine.iterdir()] == ["intel64.icd"]
    assert plan_registrations(TIMEOUT_S) == []


def test_a_variable_that_names_the_drivers_is_refused(machine, monkeypatch):
    monkeypatch.setenv("OCL_ICD_VENDORS", "/somewhere")
    with pytest.raises(ConfigError, match="OCL_ICD_VENDORS is set"):
        plan_registrations(TIMEOUT_S)


def test_a_folder_that_cannot_be_written_to_is_one_sentence(machine):
    machine.parent.joinpath("drivers").write_text("a file")
    with pytest.raises(ConfigError, match="cannot be written"):
        carry_out([Step("write", machine / "intel64.icd", "/lib/libintelocl.so", "")])


def test_a_driver_file_of_any_folder_registers_its_library(tmp_path):
    found = [FoundLibrary(INTEL, tmp_path / "libintelocl.so")]
    assert find_unregistered(found, []) == found
    assert find_unregistered(found, [IcdFile(tmp_path / "a.icd", "libintelocl.so.2026")]) == []


def test_a_file_that_is_no_driver_is_tried_and_refused(tmp_path):
    library = tmp_path / "libintelocl.so"
    library.write_text("no library at all")
    working, failure = try_library(str(library), TIMEOUT_S)
    assert working == []
    assert failure
    assert try_library("/a\n/b", TIMEOUT_S)[0] == []


def test_a_runtime_of_intel_without_its_compilers_libraries_is_told_what_brings_them(monkeypatch):
    failure = "libimf.so: cannot open shared object file: No such file or directory"
    monkeypatch.setattr(register, "run_probe", lambda *_, **__: ProbeResult({}, failure, "", 0.1))
    working, reason = try_library("/lib/libintelocl.so", TIMEOUT_S)
    assert working == []
    assert reason.startswith(failure)
    assert "pip install intel-cmplr-lib-rt" in reason
