"""The doctor's checks and registrations on made-up machines, what the loader is shown, and probes of real processes."""

import ctypes
import os
import struct
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from clbvh import DeviceError
from clbvh.device import doctor, driver_files, pocl_3
from clbvh.device.doctor import check_gpus, diagnose, register_drivers, try_library
from clbvh.device.driver_files import DriverFile, added_drivers, find_added, find_bundled_folder, find_folders
from clbvh.device.pocl_3 import choose_name, prepare_pocl_3
from clbvh.device.probe import ProbeResult, run_probe

from .made_up_devices import GEFORCE, POCL_3

TIMEOUT_S = 60


def test_gpus_without_a_device_are_found_on_the_bus(tmp_path):
    # A bridge, a card and its sound, a card without a display, a virtual display, and the first card once more.
    devices = [(0x8086, 0x060100), (0x10DE, 0x030200), (0x10DE, 0x040300)]
    devices += [(0x1002, 0x120000), (0x1AF4, 0x030000), (0x10DE, 0x030200)]
    for number, (vendor, pci_class) in enumerate(devices):
        folder = tmp_path / f"0000:{number:02}:00.0"
        folder.mkdir()
        (folder / "vendor").write_text(f"{vendor:#06x}\n")
        (folder / "class").write_text(f"{pci_class:#08x}\n")
    (tmp_path / "0000:07:00.0").mkdir()
    findings = list(check_gpus([POCL_3], tmp_path))
    assert [finding.message.split()[5] for finding in findings] == ["NVIDIA", "AMD"]
    assert all(finding.advice for finding in findings)
    # The CPU is called "AMD EPYC": that is no GPU of AMD.
    assert [finding.message.split()[5] for finding in check_gpus([POCL_3, GEFORCE], tmp_path)] == ["AMD"]
    assert list(check_gpus([], tmp_path / "no bus")) == []


@pytest.fixture
def drivers(tmp_path, monkeypatch):
    """A machine on which Intel's library lies in no folder of the loader; returns the folder for its drivers."""
    for variable in driver_files.VENDOR_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("CLBVH_DRIVERS", str(tmp_path / "drivers"))
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path / "lib"))
    monkeypatch.setattr(doctor, "_LIBRARY_FOLDERS", [])
    monkeypatch.setattr(doctor.sys, "prefix", str(tmp_path))
    monkeypatch.setattr(doctor, "try_library", lambda *_: (["Xeon"], ""))
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib/libintelocl.so").touch()
    return tmp_path / "drivers"


def test_a_registration_whose_library_is_gone_is_replaced_but_not_by_a_driver_that_does_not_work(drivers, monkeypatch):
    drivers.mkdir()
    (drivers / "intel64.icd").write_text("/gone/libintelocl.so\n")
    (step,) = register_drivers(TIMEOUT_S, dry_run=False)
    assert (step.action, step.path, step.path.read_text()) == ("write", drivers / "intel64.icd", f"{step.library}\n")
    step.path.unlink()
    monkeypatch.setattr(doctor, "try_library", lambda *_: ([], "was killed by SIGSEGV"))
    (step,) = register_drivers(TIMEOUT_S, dry_run=False)
    assert (step.action, step.reason) == ("leave", "was killed by SIGSEGV")
    assert list(drivers.iterdir()) == []


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A machine with two drivers of the system's; returns the folder for its user's."""
    for name in ("system", "own", "bundled"):
        (tmp_path / name).mkdir()
    for name in ("libsystem.so.1.2", "libmine.so"):
        (tmp_path / name).touch()
    (tmp_path / "libsystem.so.1").symlink_to("libsystem.so.1.2")
    (tmp_path / "system/system.icd").write_text(f"{tmp_path}/libsystem.so.1\n")
    (tmp_path / "system/bare.icd").write_text("libbare.so.3\n")
    monkeypatch.setattr(driver_files, "SYSTEM_VENDORS", tmp_path / "system")
    monkeypatch.setattr(driver_files, "_callers", [])
    monkeypatch.setattr(driver_files, "find_bundled_folder", lambda: tmp_path / "bundled")
    monkeypatch.setenv("CLBVH_DRIVERS", str(tmp_path / "own"))
    for variable in driver_files.VENDOR_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    return tmp_path / "own"


def register(own, name, library):
    (own / name).write_text(f"{library}\n")
    return DriverFile(own / name, str(library))


def test_a_library_that_is_there_is_offered_unless_the_loader_finds_it_by_itself(own, tmp_path):
    mine = register(own, "mine.icd", tmp_path / "libmine.so")
    (tmp_path / "deeper").mkdir()
    (tmp_path / "deeper/libbare.so.3").touch()
    libraries = ("libgone.so", "", "deeper", "libsystem.so.1", "libsystem.so.1.2", "deeper/libbare.so.3", "libmine.so")
    for number, library in enumerate(libraries):
        register(own, f"other{number}.icd", tmp_path / library)
    register(own, "relative.icd", "libmine.so")
    assert find_added() == [mine]


def test_the_loader_sees_the_files_of_the_system_and_the_users_for_one_call(own, tmp_path):
    register(own, "system.icd", tmp_path / "libmine.so")
    expected = [f"{tmp_path}/libsystem.so.1\n", "libbare.so.3\n", f"{tmp_path}/libmine.so\n"]
    seen = []

    def look():
        with added_drivers():
            seen.append(Path(os.environ["OCL_ICD_VENDORS"]))
            assert sorted(path.read_text() for path in seen[0].glob("*.icd")) == sorted(expected)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        look()
    assert "OCL_ICD_VENDORS" not in os.environ
    assert not seen[0].exists()


def test_the_loader_is_left_alone_without_a_driver_after_the_first_call_and_without_a_folder_for_temporary_files(
    own, tmp_path, monkeypatch
):
    with added_drivers():
        assert "OCL_ICD_VENDORS" not in os.environ
    register(own, "mine.icd", tmp_path / "libmine.so")
    with added_drivers():
        assert "OCL_ICD_VENDORS" not in os.environ
    monkeypatch.setattr(driver_files, "_callers", [])
    monkeypatch.setattr(driver_files.tempfile, "tempdir", str(tmp_path / "no such folder"))
    with added_drivers():
        assert "OCL_ICD_VENDORS" not in os.environ


def test_the_folders_of_driver_files(own, tmp_path, monkeypatch):
    assert find_folders() == [tmp_path / "system", own, tmp_path / "bundled"]
    register(own, "mine.icd", tmp_path / "libmine.so")
    for variable in driver_files.VENDOR_VARIABLES:
        with monkeypatch.context() as patch:
            patch.setenv(variable, str(tmp_path))
            assert find_folders() == [tmp_path, tmp_path / "bundled"]
            assert find_added() == []
    monkeypatch.setenv("CLBVH_DRIVERS", "")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    assert sys.platform != "linux" or find_folders()[1] == tmp_path / "config/clbvh/drivers"
    # The loader of a conda environment reads the environment.
    monkeypatch.setattr(driver_files.sys, "prefix", str(tmp_path))
    monkeypatch.setattr(driver_files, "find_bundled_folder", lambda: None)
    (tmp_path / "etc/OpenCL/vendors").mkdir(parents=True)
    assert find_folders()[0] == tmp_path / "etc/OpenCL/vendors"


LIST = """
import os
from clbvh.device.select import list_devices
print(len(list_devices()), len(list_devices()))
assert "OCL_ICD_VENDORS" not in os.environ
"""


def list_in_a_process(own):
    """Count the devices in a process without a variable that names drivers; its loader reports what it reads."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("OCL_", "OPENCL_"))}
    environment = kept | {"CLBVH_DRIVERS": str(own), "OCL_ICD_DEBUG": "15"}
    command = [sys.executable, "-c", LIST]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=True)


def test_the_real_loader_is_led_to_a_registered_library_and_lists_no_pocl_twice(tmp_path):
    bundled = find_bundled_folder()
    if bundled is None:
        pytest.skip("this pyopencl has no loader of its own, so its words are unknown")
    own, library = tmp_path / "drivers", tmp_path / "libmine.so"
    own.mkdir()
    library.write_text("no library at all")
    alone = list_in_a_process(own)
    assert str(library) not in alone.stderr
    register(own, "mine.icd", library)
    for pocl in bundled.glob("libpocl*"):
        (tmp_path / "libpocl.so.2").symlink_to(pocl)
        register(own, "pocl.icd", tmp_path / "libpocl.so.2")
        break
    shown = list_in_a_process(own)
    # It is refused, and harms none of the others.
    assert f"Loading ICD '{library}'" in shown.stderr
    assert shown.stdout == alone.stdout


@pytest.fixture
def break_pyopencl(tmp_path, monkeypatch):
    """A function from code that every new process runs on pyopencl when it starts, as a broken driver would act."""

    def run(code):
        (tmp_path / "sitecustomize.py").write_text("import os, time\nimport pyopencl as cl\n" + code)
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
        # Two texts of one length, written in one second, share their bytecode.
        monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")

    return run


# A true fault: LLVM, once loaded, swallows a signal that is merely sent.
CRASH = "import ctypes\ndef crash(*_, **__): ctypes.string_at(0)\n"


def test_a_driver_that_crashes_is_reported_and_the_doctor_and_the_host_live(break_pyopencl):
    break_pyopencl(CRASH + "cl.Program.build = crash\n")
    findings, (host, *others) = diagnose(TIMEOUT_S)
    assert (host.device.is_host, host.error, findings[0].severity) == (True, "", "ok")
    assert {trial.error for trial in others} == {"was killed by SIGSEGV"}
    break_pyopencl(CRASH + "cl.get_platforms = crash\n")
    findings, trials = diagnose(TIMEOUT_S)
    assert [trial.device.is_host for trial in trials] == [True]
    (finding,) = [finding for finding in findings if "was killed by SIGSEGV" in finding.message]
    assert finding.severity == "problem"
    assert any("OCL_ICD_VENDORS=" in line for line in finding.advice)


def test_a_host_that_lacks_its_kernels_or_computes_wrong_numbers_is_the_first_problem(monkeypatch):
    monkeypatch.setattr(doctor, "run_probe", lambda *words, **_: ProbeResult({"pyopencl": "1"}, "", ""))
    assert doctor.diagnose(TIMEOUT_S)[0][0].severity == "ok"
    monkeypatch.setattr(doctor, "run_probe", lambda *words, **_: ProbeResult({}, "was killed by SIGILL", ""))
    findings, (host,) = diagnose(TIMEOUT_S)
    assert (host.error, findings[0].severity, findings[0].check) == ("was killed by SIGILL", "problem", "host")
    monkeypatch.setattr(doctor, "fits_sources", lambda path: False)
    findings, trials = diagnose(TIMEOUT_S)
    assert trials == []
    assert "do not fit their sources" in findings[0].message

    def fail():
        raise DeviceError("the compiled kernels are missing")

    monkeypatch.setattr(doctor, "open_library", fail)
    findings, _ = diagnose(TIMEOUT_S)
    assert (findings[0].severity, findings[0].message) == ("problem", "the compiled kernels are missing")


def test_a_driver_without_devices_is_not_registered_for_the_hosts_sake(tmp_path):
    working, failure = try_library("libc.so.6", TIMEOUT_S)
    assert (working, bool(failure)) == ([], True)


# The numbers are all wrong: not even the first one, zero, may be right because the memory happened to hold it.
IDLE = """
build = cl.Program.__init__
def init(self, context, text): build(self, context, text.replace('= pair;', '= ~0ul;'))
cl.Program.__init__ = init
"""
NOISY = "platforms = cl.get_platforms\ncl.get_platforms = lambda: os.write(1, b'hello\\n') and platforms()\n"


def test_a_driver_that_fails_at_its_end_computes_nothing_or_prints(break_pyopencl):
    for code, words, failure in [
        (CRASH + "import atexit; atexit.register(crash)\n", ("try", "1"), "answered, but then was killed by SIGSEGV"),
        (IDLE, ("try", "1"), "computed 1025 of 1025 numbers wrong"),
        (NOISY, ("list",), ""),
    ]:
        break_pyopencl(code)
        assert run_probe(*words, timeout_s=TIMEOUT_S).failure == failure


def make_record(*pointers):
    """A record of 2 KiB such as PoCL has, with pointers at odd places, and elsewhere numbers that are no addresses."""
    fields = [7, 2**64 - 1, 0, 4096] * 64
    for place, pointer in enumerate(pointers):
        fields[80 + 3 * place] = ctypes.addressof(pointer)
    return ctypes.create_string_buffer(struct.pack("<256Q", *fields), 2048)


def name_cpu(record, version="OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-generic", driver="3.0-rc2"):
    handle = SimpleNamespace(int_ptr=ctypes.addressof(record) if record else 8)
    prepare_pocl_3(SimpleNamespace(version=version, driver_version=driver, cl_device=handle))


@pytest.mark.skipif(sys.platform != "linux", reason="the processor is named on Linux only")
def test_a_processor_that_pocl_does_not_know_gets_a_name_and_all_others_are_left_alone(monkeypatch):
    monkeypatch.setattr(pocl_3, "_find_missing", list)
    word, other = (ctypes.create_string_buffer(b"generic", 16) for _ in range(2))
    record = make_record(word)
    for version, driver in [
        ("OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-znver3", "3.0-rc2"),
        ("OpenCL 3.0 PoCL HSTR: cpu-x86_64-pc-linux-gnu-generic", "6.0"),
        ("OpenCL 3.0 CUDA", "550.54"),
        ("", "3.0"),
    ]:
        name_cpu(record, version, driver)
        assert word.value == b"generic"
    # Two pointers to such words, none, and no memory at all.
    for unclear in (make_record(word, other), make_record(), None):
        name_cpu(unclear)
    assert word.value == other.value == b"generic"
    before = record.raw
    name_cpu(record)
    assert word.value in (b"skx", b"haswell", b"x86-64")
    assert word.raw[8:] == bytes(8)
    assert record.raw == before


def test_the_name_promises_no_more_than_the_processor_has():
    avx2 = "avx2 bmi1 bmi2 f16c fma abm movbe rdrand"
    avx512 = "avx512f avx512bw avx512cd avx512dq avx512vl adx rdseed xsavec xsaves"
    for flags, name in {
        f"{avx2} {avx512} sse2": b"skx",
        f"{avx2} {avx512}".replace("avx512vl", ""): b"haswell",
        avx512: b"x86-64",
        avx2: b"haswell",
        avx2.replace("fma", ""): b"x86-64",
    }.items():
        padded = choose_name(set(flags.split()))
        assert len(padded) == 7
        assert padded.rstrip(b"\0") == name, flags
