"""The doctor's checks on made-up machines, its registrations, and its probes on real processes."""

from pathlib import Path

import pytest

from clbvh.device import doctor
from clbvh.device.doctor import (
    CPU_DRIVERS,
    advise,
    check_gpus,
    diagnose,
    find_unregistered,
    register_drivers,
    try_library,
)
from clbvh.device.driver_files import DriverFile
from clbvh.device.probe import ProbeResult, run_probe
from clbvh.errors import ConfigError

from .made_up_devices import GEFORCE, POCL_3

DOCS = Path(__file__).parents[3] / "docs"
TIMEOUT_S = 60


def make_pci_device(root, address, vendor, pci_class):
    folder = root / address
    folder.mkdir(parents=True)
    (folder / "vendor").write_text(f"{vendor:#06x}\n")
    (folder / "class").write_text(f"{pci_class:#08x}\n")


def test_gpus_without_a_device_are_found_on_the_bus(tmp_path):
    make_pci_device(tmp_path, "0000:00:1f.0", 0x8086, 0x060100)  # a bridge
    make_pci_device(tmp_path, "0000:01:00.0", 0x10DE, 0x030200)
    make_pci_device(tmp_path, "0000:01:00.1", 0x10DE, 0x040300)  # its sound
    make_pci_device(tmp_path, "0000:02:00.0", 0x1002, 0x120000)  # a card without a display
    make_pci_device(tmp_path, "0000:03:00.0", 0x1AF4, 0x030000)  # a virtual display
    make_pci_device(tmp_path, "0000:04:00.0", 0x10DE, 0x030200)
    (tmp_path / "0000:05:00.0").mkdir()
    findings = list(check_gpus([POCL_3], tmp_path))
    assert [finding.message.split()[5] for finding in findings] == ["NVIDIA", "AMD"]
    assert all(finding.advice for finding in findings)
    # The CPU is called "AMD EPYC": that is no GPU of AMD.
    assert [finding.message.split()[5] for finding in check_gpus([POCL_3, GEFORCE], tmp_path)] == ["AMD"]
    assert list(check_gpus([], tmp_path / "no bus")) == []


# The words of the report in pocl/pocl issue 1049.
UNKNOWN_CPU = "clBuildProgram failed: BUILD_PROGRAM_FAILURE\nerror: unknown target CPU 'generic'"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (UNKNOWN_CPU, "POCL_LLVM_CPU_NAME"),
        (f"{POCL_3} was killed by SIGILL", "older than the CPU"),
        (f"{GEFORCE} was killed by SIGILL", "update the driver"),
        ("did not answer within 60 s", "hangs"),
        ("write failed: No space left on device", "CUDA_CACHE_PATH"),
        ("the platform 'Portable Computing Language' offers no device", "POCL_CACHE_DIR"),
        ("the platform 'rusticl' offers no device", "RUSTICL_ENABLE=radeonsi"),
        ("libimf.so: cannot open shared object file", "pip install intel-cmplr-lib-rt"),
        ("something else", "update the driver"),
    ],
)
def test_advice_fits_the_failure(text, expected):
    assert expected in "\n".join(advise(text))


@pytest.mark.parametrize("machine", CPU_DRIVERS)
def test_the_documentation_has_the_commands_of_each_platform(machine):
    commands = "; ".join(f"`{command.removeprefix('$ ')}`" for command in CPU_DRIVERS[machine])
    rows = [line for line in (DOCS / "devices.md").read_text().splitlines() if line.endswith(f"| {commands} |")]
    assert len(rows) == 1


# The registration


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine on which Intel's library lies in no folder of the loader; returns the folder for its drivers."""
    for variable in ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("CLBVH_DRIVERS", str(tmp_path / "drivers"))
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path / "lib"))
    monkeypatch.setattr(doctor, "_LIBRARY_FOLDERS", [])
    monkeypatch.setattr(doctor.sys, "prefix", str(tmp_path))
    monkeypatch.setattr(doctor, "try_library", lambda *_: (["Xeon"], ""))
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib/libintelocl.so").touch()
    return tmp_path / "drivers"


def test_libraries_that_no_driver_file_names_are_found_once(machine, tmp_path):
    for name in ("libnvidia-opencl.so.1", "libnvidia-opencl.so.570.86", "libcuda.so.1"):
        (tmp_path / "lib" / name).touch()
    intel, nvidia = tmp_path / "lib/libintelocl.so", tmp_path / "lib/libnvidia-opencl.so.1"
    assert sorted(find_unregistered([])) == [(intel, "intel64.icd"), (nvidia, "nvidia.icd")]
    assert find_unregistered([DriverFile(tmp_path / "a.icd", "libintelocl.so.2026")]) == [(nvidia, "nvidia.icd")]


def test_a_driver_that_works_is_registered_once(machine, tmp_path):
    (step,) = register_drivers(TIMEOUT_S, dry_run=True)
    library = tmp_path / "lib/libintelocl.so"
    assert (step.action, step.path, step.library, step.reason) == (
        ("write", machine / "intel64.icd", str(library), "Xeon")
    )
    assert not machine.exists()
    assert register_drivers(TIMEOUT_S, dry_run=False) == [step]
    assert step.path.read_text() == f"{library}\n"
    assert [file.name for file in machine.iterdir()] == ["intel64.icd"]
    assert register_drivers(TIMEOUT_S, dry_run=False) == []


def test_a_driver_that_does_not_work_is_left_alone_with_the_reason(machine, monkeypatch):
    monkeypatch.setattr(doctor, "try_library", lambda *_: ([], "was killed by SIGSEGV"))
    (step,) = register_drivers(TIMEOUT_S, dry_run=False)
    assert (step.action, step.reason) == ("leave", "was killed by SIGSEGV")
    assert not machine.exists()


def test_a_registration_whose_library_is_gone_is_replaced(machine, tmp_path):
    machine.mkdir()
    (machine / "intel64.icd").write_text("/gone/libintelocl.so\n")
    (step,) = register_drivers(TIMEOUT_S, dry_run=False)
    assert (step.action, step.path) == ("write", machine / "intel64.icd")
    assert step.path.read_text() == f"{tmp_path}/lib/libintelocl.so\n"


def test_what_keeps_a_registration_from_counting_is_one_sentence(machine, monkeypatch):
    machine.write_text("a file")
    with pytest.raises(ConfigError, match="cannot be written"):
        register_drivers(TIMEOUT_S, dry_run=False)
    monkeypatch.setenv("OCL_ICD_VENDORS", "/somewhere")
    with pytest.raises(ConfigError, match="OCL_ICD_VENDORS is set"):
        register_drivers(TIMEOUT_S, dry_run=False)


def test_a_file_that_is_no_driver_is_tried_and_refused(tmp_path):
    library = tmp_path / "libintelocl.so"
    library.write_text("no library at all")
    working, failure = try_library(str(library), TIMEOUT_S)
    assert working == []
    assert failure


def test_a_runtime_of_intel_without_its_compilers_libraries_is_told_what_brings_them(monkeypatch):
    failure = "libimf.so: cannot open shared object file: No such file or directory"
    monkeypatch.setattr(doctor, "run_probe", lambda *_, **__: ProbeResult({}, failure, ""))
    working, reason = try_library("/lib/libintelocl.so", TIMEOUT_S)
    assert working == []
    assert reason.startswith(failure)
    assert "pip install intel-cmplr-lib-rt" in reason


# The probes


def test_each_device_of_this_machine_passes_its_trial():
    listing = run_probe("list", timeout_s=TIMEOUT_S)
    assert listing.failure == ""
    assert listing.answer["devices"]
    for device in listing.answer["devices"]:
        result = run_probe("try", str(device["number"]), timeout_s=TIMEOUT_S)
        assert result.failure == ""


def test_a_missing_library_and_a_missing_device_fail_with_the_reason():
    assert "libgone.so.7" in run_probe("load", "libgone.so.7", timeout_s=TIMEOUT_S).failure
    assert "no device 99" in run_probe("try", "99", timeout_s=TIMEOUT_S).failure
    assert run_probe("load", "libc.so.6", timeout_s=TIMEOUT_S).failure == ""


def break_pyopencl(folder, monkeypatch, code):
    """Have every new process run some code on pyopencl when it starts, as a broken driver would act."""
    (folder / "sitecustomize.py").write_text("import os, time\nimport pyopencl as cl\n" + code)
    monkeypatch.setenv("PYTHONPATH", str(folder))


# A true fault: LLVM, once loaded, swallows a signal that is merely sent.
CRASH = "import ctypes\ndef crash(*_): ctypes.string_at(0)\n"


def test_a_driver_that_crashes_while_compiling_is_reported_and_the_doctor_lives(tmp_path, monkeypatch):
    break_pyopencl(tmp_path, monkeypatch, CRASH + "cl.Program.build = crash\n")
    _, trials = diagnose(TIMEOUT_S)
    assert trials
    for trial in trials:
        assert trial.error == "was killed by SIGSEGV"


def test_a_driver_that_crashes_while_it_is_listed_is_reported(tmp_path, monkeypatch):
    break_pyopencl(tmp_path, monkeypatch, CRASH + "cl.get_platforms = crash\n")
    findings, trials = diagnose(TIMEOUT_S)
    assert trials == []
    (finding,) = [finding for finding in findings if "was killed by SIGSEGV" in finding.message]
    assert any("OCL_ICD_VENDORS=" in line for line in finding.advice)


def test_a_driver_that_crashes_when_it_is_closed_is_not_called_good(tmp_path, monkeypatch):
    break_pyopencl(tmp_path, monkeypatch, CRASH + "import atexit; atexit.register(crash)\n")
    result = run_probe("try", "0", timeout_s=TIMEOUT_S)
    assert result.failure == "answered, but then was killed by SIGSEGV"


def test_a_driver_that_hangs_is_given_up(tmp_path, monkeypatch):
    break_pyopencl(tmp_path, monkeypatch, "cl.get_platforms = lambda: time.sleep(600)\n")
    result = run_probe("list", timeout_s=1.5)
    assert result.failure == "did not answer within 1.5 s"


def test_a_driver_that_runs_without_computing_fails_its_trial(tmp_path, monkeypatch):
    idle = """
build = cl.Program.__init__
def init(self, context, text): build(self, context, text.replace('x[i] =', 'float lost ='))
cl.Program.__init__ = init
"""
    break_pyopencl(tmp_path, monkeypatch, idle)
    # All of them: not even the first one, zero, may be right because the memory happened to hold it.
    assert run_probe("try", "0", timeout_s=TIMEOUT_S).failure == "computed 1025 of 1025 numbers wrong"


def test_what_a_driver_prints_does_not_reach_the_answer(tmp_path, monkeypatch):
    noisy = "platforms = cl.get_platforms\ncl.get_platforms = lambda: os.write(1, b'hello\\n') and platforms()\n"
    break_pyopencl(tmp_path, monkeypatch, noisy)
    result = run_probe("list", timeout_s=TIMEOUT_S)
    assert result.failure == ""
    assert "hello" in result.log
