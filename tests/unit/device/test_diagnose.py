"""The doctor's checks, each on a machine that was made up for it, and its probes on real processes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clbvh.device import icd_files
from clbvh.device.doctor import drivers
from clbvh.device.doctor.advice import advise_cpu_driver, advise_failure, advise_icd, advise_pyopencl
from clbvh.device.doctor.diagnose import (
    Trial,
    check_choice,
    check_device_files,
    check_hardware,
    check_icd_files,
    check_libraries,
    check_listing,
    check_loader_rule,
    check_pyopencl,
    check_trial,
    diagnose,
    read_devices,
)
from clbvh.device.doctor.drivers import KNOWN_DRIVERS, DeviceFile, FoundLibrary
from clbvh.device.doctor.platforms import find_commands
from clbvh.device.doctor.probe import ProbeResult, run_probe
from clbvh.device.icd_files import IcdFile, LoaderRule
from clbvh.device.info import DeviceInfo

TIMEOUT_S = 60

POCL = DeviceInfo(
    number=0,
    platform="Portable Computing Language",
    platform_version="OpenCL 3.0 PoCL 3.0-rc2 Linux, LLVM 14.0.6",
    name="pthread-AMD EPYC",
    vendor="AuthenticAMD",
    version="OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-generic",
    driver_version="3.0-rc2",
    kind="cpu",
    memory_bytes=1 << 32,
    max_allocation_bytes=1 << 30,
    compute_units=2,
    has_fp64=True,
)
GEFORCE = DeviceInfo(
    number=1,
    platform="NVIDIA CUDA",
    platform_version="OpenCL 3.0 CUDA 12.8.93",
    name="NVIDIA GeForce RTX 4090",
    vendor="NVIDIA Corporation",
    version="OpenCL 3.0 CUDA",
    driver_version="570.86",
    kind="gpu",
    memory_bytes=24 << 30,
    max_allocation_bytes=6 << 30,
    compute_units=128,
    has_fp64=True,
)


def commands_of(advice):
    return [line.removeprefix("$ ") for line in advice if line.startswith("$ ")]


def severities_of(findings):
    return [(finding.check, finding.severity) for finding in findings]


# Where the loader looks


def test_the_loader_reads_etc_and_its_own_folder():
    bundled = Path("/site/pyopencl/.libs")
    rule = icd_files.read_loader_rule({}, bundled)
    assert rule == LoaderRule((Path("/etc/OpenCL/vendors"), bundled), "", "", bundled)


@pytest.mark.parametrize("variable", icd_files.VENDOR_VARIABLES)
def test_a_variable_replaces_etc_but_not_the_loaders_own_folder(tmp_path, variable):
    rule = icd_files.read_loader_rule({variable: str(tmp_path)}, Path("/bundled"))
    assert rule.folders == (tmp_path, Path("/bundled"))
    assert rule.variable == variable


def test_what_is_no_folder_is_the_only_driver(tmp_path):
    rule = icd_files.read_loader_rule({"OCL_ICD_VENDORS": str(tmp_path / "one.icd")}, Path("/bundled"))
    assert rule.folders == ()
    assert rule.single == str(tmp_path / "one.icd")


def test_the_loader_of_a_conda_environment_reads_the_environment(tmp_path):
    (tmp_path / "conda-meta").mkdir()
    assert icd_files.read_loader_rule({}, None, str(tmp_path)).folders == (tmp_path / "etc/OpenCL/vendors",)
    assert icd_files.read_loader_rule({}, Path("/b"), str(tmp_path)).folders[0] == icd_files.SYSTEM_VENDORS


def test_driver_files_are_read_as_the_loader_reads_them(tmp_path):
    (tmp_path / "b.icd").write_text("/opt/libb.so\nsecond line\n")
    (tmp_path / "a.icd").write_text("liba.so \r\n")
    (tmp_path / "empty.icd").write_text("")
    (tmp_path / "folder.icd").mkdir()
    (tmp_path / "c.icd.disabled").write_text("libc.so\n")
    found = icd_files.find_icd_files(LoaderRule((tmp_path, tmp_path / "not there")))
    assert [(icd.path.name, icd.library) for icd in found] == [
        ("a.icd", "liba.so \r"),
        ("b.icd", "/opt/libb.so"),
        ("empty.icd", ""),
        ("folder.icd", ""),
    ]


def test_the_only_driver_is_a_driver_file_or_a_library(tmp_path):
    icd = tmp_path / "one.icd"
    icd.write_text("libone.so\n")
    assert icd_files.find_icd_files(LoaderRule((), str(icd))) == [IcdFile(icd, "libone.so")]
    assert icd_files.find_icd_files(LoaderRule((), "libtwo.so")) == [IcdFile(Path("libtwo.so"), "libtwo.so")]


def test_a_neighbour_of_the_bundled_loader_is_found_by_its_bare_name(tmp_path):
    (tmp_path / "libpocl-1.so").touch()
    icd = IcdFile(tmp_path / "pocl.icd", "libpocl-1.so")
    assert icd.loadable_name(LoaderRule((), bundled=tmp_path)) == str(tmp_path / "libpocl-1.so")
    assert icd.loadable_name(LoaderRule((tmp_path,), bundled=None)) == "libpocl-1.so"


def test_the_rule_of_this_machine_is_the_one_its_loader_follows(tmp_path):
    # The loader reports what it reads; the same must come out of our reading of its rules.
    bundled = icd_files.find_bundled_folder()
    if bundled is None:
        pytest.skip("this pyopencl has no loader of its own whose rules could be compared")
    (tmp_path / "gone.icd").write_text("libgone.so.7\n")
    for value in (str(tmp_path), str(tmp_path / "gone.icd"), str(tmp_path / "nothing")):
        environment = os.environ | {"OCL_ICD_VENDORS": value, "OCL_ICD_DEBUG": "15"}
        code = "import pyopencl as cl\ntry: cl.get_platforms()\nexcept cl.Error: pass"
        answer = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=60, check=True
        )
        opened = {line.split("'")[1] for line in answer.stderr.splitlines() if "Loading ICD '" in line}
        expected = icd_files.find_icd_files(icd_files.read_loader_rule(environment, bundled))
        assert opened == {icd.library for icd in expected}


# What is installed


def test_libraries_are_found_by_folder_and_by_cache_one_for_each_driver(tmp_path):
    for name in ("libnvidia-opencl.so.1", "libnvidia-opencl.so.570.86", "libpocl.so.2.12.0", "libcuda.so.1"):
        (tmp_path / name).touch()
    elsewhere = tmp_path / "rocm"
    elsewhere.mkdir()
    (elsewhere / "libamdocl64.so").touch()
    found = drivers.find_libraries(
        [tmp_path, tmp_path / "none"], [elsewhere / "libamdocl64.so", Path("/x/libigdrcl.so")]
    )
    assert [library.path.name for library in found] == [
        "libnvidia-opencl.so.1",
        "libamdocl64.so",
        "libpocl.so.2.12.0",
    ]


def test_the_64_bit_copy_of_a_library_comes_first():
    text = (
        "2 libs found in cache `/etc/ld.so.cache'\n"
        "\tlibnvidia-opencl.so.1 (libc6) => /lib/i386-linux-gnu/libnvidia-opencl.so.1\n"
        "\tlibnvidia-opencl.so.1 (libc6,x86-64) => /lib/x86_64-linux-gnu/libnvidia-opencl.so.1\n"
    )
    assert drivers.parse_library_cache(text) == [
        Path("/lib/x86_64-linux-gnu/libnvidia-opencl.so.1"),
        Path("/lib/i386-linux-gnu/libnvidia-opencl.so.1"),
    ]


def test_a_library_that_no_driver_file_names_is_reported(tmp_path):
    for name in ("libnvidia-opencl.so.1", "libpocl.so.2"):
        (tmp_path / name).touch()
    libraries = drivers.find_libraries([tmp_path])
    both = [IcdFile(Path("n.icd"), "libnvidia-opencl.so.1"), IcdFile(Path("p.icd"), "/usr/lib/libpocl.so.2.9")]
    assert check_libraries(libraries, both) == []
    (finding,) = check_libraries(libraries, both[1:])
    assert finding.severity == "problem"
    assert str(tmp_path / "libnvidia-opencl.so.1") in finding.message
    # A second driver for the CPU may well be left out on purpose.
    assert severities_of(check_libraries(libraries, both[:1])) == [("driver library", "note")]


def test_the_advice_to_register_a_driver_works_when_it_is_followed(tmp_path):
    bundled = icd_files.find_bundled_folder()
    pocl = sorted(bundled.glob("libpocl*")) if bundled is not None else []
    if not pocl:
        pytest.skip("no PoCL inside pyopencl to register")
    # A careless command would make one blank of the two.
    folder = tmp_path / "some  driver"
    folder.symlink_to(bundled)
    library = FoundLibrary(next(known for known in KNOWN_DRIVERS if known.vendor == "PoCL"), folder / pocl[0].name)
    (command,) = [line for line in commands_of(advise_icd(library)) if "sudo" in line]
    command = command.replace("sudo", "").replace(str(icd_files.SYSTEM_VENDORS), str(tmp_path))
    # Nothing but the new file is there: the loader's own folder does not count when a single file is named.
    script = "\n".join(
        [command, f'export OCL_ICD_VENDORS="{tmp_path}/pocl.icd"', '"$0" -m clbvh.device.doctor.probe list']
    )
    answer = subprocess.run(
        ["sh", "-c", script, sys.executable],
        capture_output=True,
        text=True,
        check=True,
        timeout=TIMEOUT_S,
        env=os.environ | {"HOME": str(tmp_path), "POCL_CACHE_DIR": str(tmp_path)},
    )
    assert '"Portable Computing Language"' in answer.stdout


def make_pci_device(root, address, vendor, pci_class):
    folder = root / address
    folder.mkdir(parents=True)
    (folder / "vendor").write_text(f"{vendor:#06x}\n")
    (folder / "class").write_text(f"{pci_class:#08x}\n")


def test_gpus_are_found_on_the_bus(tmp_path):
    make_pci_device(tmp_path, "0000:00:02.0", 0x8086, 0x030000)
    make_pci_device(tmp_path, "0000:00:1f.0", 0x8086, 0x060100)  # a bridge
    make_pci_device(tmp_path, "0000:01:00.0", 0x10DE, 0x030200)
    make_pci_device(tmp_path, "0000:01:00.1", 0x10DE, 0x040300)  # its sound
    make_pci_device(tmp_path, "0000:02:00.0", 0x1002, 0x120000)  # a card without a display
    make_pci_device(tmp_path, "0000:03:00.0", 0x1AF4, 0x030000)  # a virtual display
    (tmp_path / "0000:04:00.0").mkdir()
    assert drivers.find_gpus(tmp_path) == ["Intel", "NVIDIA", "AMD"]
    assert drivers.find_gpus(tmp_path / "no bus") == []


def test_a_gpu_without_a_device_is_reported_once():
    findings = check_hardware(["NVIDIA", "NVIDIA", "AMD"], [POCL])
    assert [finding.message.split()[5] for finding in findings] == ["NVIDIA", "AMD"]
    assert all(finding.advice for finding in findings)


def test_a_gpu_with_a_device_is_not_reported():
    assert check_hardware(["NVIDIA"], [POCL, GEFORCE]) == []
    # The CPU is called "AMD EPYC": that is no GPU of AMD.
    assert severities_of(check_hardware(["AMD"], [POCL, GEFORCE])) == [("hardware", "note")]


def test_device_files_are_found_and_checked(tmp_path):
    (tmp_path / "dri").mkdir()
    for name in ("nvidiactl", "nvidia0", "nvidia-uvm", "nvidia-modeset", "dri/renderD128", "dri/card0", "tty"):
        (tmp_path / name).touch()
    found = drivers.find_device_files(tmp_path)
    assert [file.path.name for file in found] == ["nvidiactl", "nvidia-uvm", "nvidia0", "renderD128"]
    assert all(file.may_open for file in found)


def test_refused_device_files_come_with_the_way_in():
    render = DeviceFile(Path("/dev/dri/renderD128"), "", may_open=False)
    nvidia = DeviceFile(Path("/dev/nvidia0"), "NVIDIA", may_open=False)
    assert check_device_files([DeviceFile(Path("/dev/kfd"), "AMD", may_open=True)]) == []
    (finding,) = check_device_files([render, nvidia])
    assert "/dev/dri/renderD128, /dev/nvidia0" in finding.message
    assert commands_of(finding.advice) == ['sudo usermod -aG render,video "$USER"']
    (finding,) = check_device_files([nvidia])
    assert "--gpus all" in finding.advice[0]


# What the checks make of it


def make_listing(answer, failure="", log=""):
    return ProbeResult(answer, failure, log, 0.1)


def test_a_missing_pyopencl_and_a_missing_loader_get_different_advice():
    missing = make_listing({"error": "x"}, "No module named 'pyopencl'")
    (finding,) = check_pyopencl(missing, LoaderRule(()))
    assert finding.severity == "problem"
    assert not any("apt" in command for command in commands_of(finding.advice))
    loaderless = advise_pyopencl("libOpenCL.so.1: cannot open shared object file", has_bundled_loader=False)
    assert "sudo apt install ocl-icd-libopencl1" in commands_of(loaderless)


def test_a_folder_without_drivers_is_a_problem(tmp_path):
    assert severities_of(check_loader_rule(LoaderRule((tmp_path,)), [])) == [
        ("loader", "ok"),
        ("driver file", "problem"),
    ]


def test_drivers_that_a_variable_hides_are_named(tmp_path, monkeypatch):
    (tmp_path / "nvidia.icd").write_text("libnvidia-opencl.so.1\n")
    monkeypatch.setattr("clbvh.device.doctor.diagnose.SYSTEM_VENDORS", tmp_path)
    rule = LoaderRule((Path("/mine"),), "", "OCL_ICD_VENDORS")
    hiding = check_loader_rule(rule, [IcdFile(Path("/mine/a.icd"), "a")])[1]
    assert "nvidia.icd" in hiding.message
    assert commands_of(hiding.advice) == ["unset OCL_ICD_VENDORS"]


def test_a_driver_file_is_as_good_as_its_library(tmp_path):
    files = [
        IcdFile(tmp_path / "good.icd", "libgood.so"),
        IcdFile(tmp_path / "gone.icd", str(tmp_path / "libgone.so")),
        IcdFile(tmp_path / "needy.icd", "libneedy.so"),
        IcdFile(tmp_path / "empty.icd", ""),
    ]
    failures = ["", "cannot open shared object file", "libz.so.9: cannot open shared object file", "invalid"]
    findings = check_icd_files(files, [make_listing({}, failure) for failure in failures])
    assert [finding.severity for finding in findings] == ["ok", "problem", "problem", "problem"]
    assert "removed or moved" in findings[1].advice[0]
    assert "libz.so.9" in findings[2].message
    assert "another library is missing" in findings[2].advice[0]


def test_a_listing_that_crashed_says_how_to_find_the_driver():
    (finding,) = check_listing(make_listing({}, "was killed by SIGSEGV"))
    assert "SIGSEGV" in finding.message
    assert any("OCL_ICD_VENDORS=" in command for command in commands_of(finding.advice))


def test_problems_of_platforms_are_passed_on():
    problem = "the platform 'rusticl' offers no device"
    findings = check_listing(make_listing({"devices": [POCL.as_dict()], "problems": [problem]}))
    assert [finding.message for finding in findings] == [problem]
    assert commands_of(findings[0].advice) == ["export RUSTICL_ENABLE=radeonsi"]
    assert check_listing(make_listing({"devices": [], "problems": []}))[0].severity == "problem"


def test_devices_survive_the_way_through_json():
    assert read_devices(make_listing({"devices": [POCL.as_dict(), GEFORCE.as_dict()]})) == [POCL, GEFORCE]


# The words of the report in pocl/pocl issue 1049.
UNKNOWN_CPU = """clBuildProgram failed: BUILD_PROGRAM_FAILURE
error: unknown target CPU 'generic'
Device pthread-AMD Ryzen 5 5600X 6-Core Processor failed to build the program, log: error: unknown target CPU"""


def test_a_pocl_that_does_not_know_the_cpu_is_recognised_in_the_error_and_in_the_log():
    for trial, log in ((Trial(POCL, UNKNOWN_CPU, 0.1), ""), (Trial(POCL, "BUILD_PROGRAM_FAILURE", 0.1), UNKNOWN_CPU)):
        finding = check_trial(trial, log)
        assert finding.severity == "problem"
        assert "older than the CPU" in finding.advice[0]
        assert "export POCL_LLVM_CPU_NAME=x86-64-v3" in commands_of(finding.advice)
    (line,) = check_trial(Trial(POCL, UNKNOWN_CPU, 0.1)).message.splitlines()
    assert "unknown target CPU 'generic'" in line


def test_the_pocl_of_pypi_is_only_advised_over_an_older_one():
    old = DeviceInfo(**(vars(POCL) | {"driver_version": "1.8"}))
    assert any("pip install" in command for command in commands_of(advise_failure(UNKNOWN_CPU, old)))
    assert not any("pip install" in command for command in commands_of(advise_failure(UNKNOWN_CPU, POCL)))


@pytest.mark.parametrize(
    ("text", "device", "expected"),
    [
        ("was killed by SIGILL", POCL, "older than the CPU"),
        ("was killed by SIGILL", GEFORCE, "update the driver"),
        ("was killed by SIGSEGV", POCL, "POCL_DEBUG"),
        ("did not answer within 60 s", GEFORCE, "hangs"),
        ("write failed: No space left on device", GEFORCE, "CUDA_CACHE_PATH"),
        ("the platform 'Portable Computing Language' offers no device", None, "POCL_CACHE_DIR"),
        ("something else", None, "update the driver"),
    ],
)
def test_advice_fits_the_failure(text, device, expected):
    assert expected in "\n".join(advise_failure(text, device))


def test_a_machine_without_a_device_is_led_to_pocl():
    assert commands_of(advise_cpu_driver(LoaderRule(()), [])) == list(find_commands())
    registered = advise_cpu_driver(LoaderRule(()), [IcdFile(Path("/v/pocl.icd"), "libpocl-2.so")])
    assert commands_of(registered) == []


def test_a_variable_that_hides_pocl_is_to_be_unset(tmp_path):
    rule = LoaderRule((), "gone.icd", "OCL_ICD_VENDORS", tmp_path)
    assert commands_of(advise_cpu_driver(rule, [])) != ["unset OCL_ICD_VENDORS"]
    (tmp_path / "pocl.icd").touch()
    assert commands_of(advise_cpu_driver(rule, [])) == ["unset OCL_ICD_VENDORS"]


def test_the_choice_is_checked_against_the_trials(monkeypatch):
    monkeypatch.delenv("CLBVH_DEVICE", raising=False)
    geforce = DeviceInfo(**(vars(GEFORCE) | {"number": 0}))
    pocl = DeviceInfo(**(vars(POCL) | {"number": 1}))
    broken, working = Trial(geforce, "was killed by SIGSEGV", 0.1), Trial(pocl, "", 0.1)
    (finding,) = check_choice([broken, working])
    assert finding.severity == "problem"
    assert commands_of(finding.advice) == ["export CLBVH_DEVICE=1"]
    monkeypatch.setenv("CLBVH_DEVICE", "1")
    assert check_choice([broken, working])[0].severity == "ok"
    monkeypatch.setenv("CLBVH_DEVICE", "riva tnt")
    assert check_choice([broken, working])[0].severity == "problem"
    assert check_choice([]) == []


# The probes


def test_each_device_of_this_machine_passes_its_trial():
    listing = run_probe("list", timeout_s=TIMEOUT_S)
    assert listing.failure == ""
    assert listing.answer["devices"]
    assert "libOpenCL" in listing.answer["loader"]
    for device in listing.answer["devices"]:
        result = run_probe("try", str(device["number"]), timeout_s=TIMEOUT_S)
        assert result.failure == ""
        assert device["name"] in result.answer["device"]


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
    diagnosis = diagnose(TIMEOUT_S)
    assert diagnosis.trials
    assert not diagnosis.works
    for trial in diagnosis.trials:
        assert trial.error == "was killed by SIGSEGV"


def test_a_driver_that_crashes_while_it_is_listed_is_reported(tmp_path, monkeypatch):
    break_pyopencl(tmp_path, monkeypatch, CRASH + "cl.get_platforms = crash\n")
    diagnosis = diagnose(TIMEOUT_S)
    assert diagnosis.trials == ()
    assert any("was killed by SIGSEGV" in finding.message for finding in diagnosis.findings)


def test_a_driver_that_crashes_when_it_is_closed_is_not_called_good(tmp_path, monkeypatch):
    break_pyopencl(tmp_path, monkeypatch, CRASH + "import atexit; atexit.register(crash)\n")
    result = run_probe("try", "0", timeout_s=TIMEOUT_S)
    assert result.failure == "answered, but then was killed by SIGSEGV"


def test_a_driver_that_hangs_is_given_up(tmp_path, monkeypatch):
    break_pyopencl(tmp_path, monkeypatch, "cl.get_platforms = lambda: time.sleep(600)\n")
    result = run_probe("list", timeout_s=1.5)
    assert result.failure == "did not answer within 1.5 s"
    assert result.wall_s < 10


def test_a_driver_that_runs_without_computing_fails_its_trial(tmp_path, monkeypatch):
    idle = """
build = cl.Program.__init__
def init(self, context, text): build(self, context, text.replace('target[i] =', 'float lost ='))
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
