"""The devices of made-up machines and of this one: their order, and which of them a word means."""

import sys
from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest

from clbvh import DeviceError, choose_device, list_devices
from clbvh.device import driver_files, select
from clbvh.device.driver_files import may_serve_gpus
from clbvh.device.select import (
    DeviceSurvey,
    number_devices,
    pick_device,
    survey_devices,
)

from . import made_up_devices as made_up
from .made_up_devices import (
    APPLE,
    BOARD,
    EMULATOR,
    GEFORCE,
    HOST,
    INTEL_CPU,
    INTEL_XEON,
    IRIS,
    LLVMPIPE,
    OCLGRIND,
    POCL_3,
    POCL_6,
    POCL_ARM,
    POCL_M2,
    POCL_XEON,
    RADEON,
    RADEON_OF_MESA,
    UHD,
)


def names_of(devices):
    return [device.name for device in devices]


def test_the_host_comes_first_then_a_graphics_card_then_the_one_inside_the_cpu_then_accelerators_then_cpus():
    expected = [HOST, GEFORCE, RADEON, IRIS, BOARD, POCL_3, EMULATOR]
    ordered = number_devices([POCL_3, IRIS, EMULATOR, BOARD, GEFORCE, RADEON, HOST])
    assert names_of(ordered) == names_of(expected)
    assert [device.number for device in ordered] == list(range(7))


MACHINE = number_devices([RADEON, GEFORCE, IRIS, BOARD, INTEL_CPU, POCL_6, POCL_3])
BROKEN_CARD = replace(GEFORCE, is_available=False)
MEANINGS = [
    # Beside the host, whose number is 0.
    *(([HOST, POCL_6, GEFORCE], word, HOST) for word in (0, "host", "cpu", "epyc", "host cpu", "amd epyc")),
    *(([HOST, POCL_6, GEFORCE], word, GEFORCE) for word in (None, 1, "gpu", "nvidia")),
    *(([HOST, POCL_6, GEFORCE], word, POCL_6) for word in (2, "pocl", "pocl cpu", "znver4")),
    *(([HOST, POCL_6, EMULATOR, OCLGRIND, BROKEN_CARD], word, HOST) for word in (None, "cpu")),
    ([HOST, POCL_6], "gpu", "no device matches 'gpu'"),
    ([HOST, POCL_6], "amd", "'amd' is only the maker of a processor here, and 'cpu' asks for it"),
    ([HOST, INTEL_CPU], "intel", INTEL_CPU),
    ([BROKEN_CARD, POCL_3], None, POCL_3),
    ([HOST, BOARD], None, BOARD),
    *((MACHINE, word, GEFORCE) for word in (None, 0, "gpu", "GPU", "geforce", "NVIDIA", "cuda", "4090")),
    *((MACHINE, word, RADEON) for word in (1, "1", "amd", "amd accelerated", "amd gpu")),
    *((MACHINE, word, IRIS) for word in (" 2 ", "iris", "Iris Xe", "iris(r) xe", "intel gpu", "gpu intel")),
    *((MACHINE, word, POCL_6) for word in ("cpu", "pocl", "portable computing", "epyc", "pocl cpu")),
    # The full name of one device is a part of the names of others.
    *((MACHINE, word, INTEL_CPU) for word in ("AMD EPYC", "Intel(R) OpenCL", "Intel CPU")),
    (MACHINE, "accelerator", BOARD),
    (MACHINE, "pthread-", POCL_3),
    # Makers: their driver or their card, never the processor under PoCL.
    ([POCL_XEON, INTEL_XEON], "intel", INTEL_XEON),
    ([POCL_XEON, UHD], "INTEL", UHD),
    ([POCL_XEON, INTEL_XEON, EMULATOR], "intel", INTEL_XEON),
    ([POCL_6, GEFORCE, RADEON], "amd", RADEON),
    ([POCL_6, RADEON_OF_MESA, LLVMPIPE], "amd", RADEON_OF_MESA),
    ([POCL_M2, APPLE], "apple", APPLE),
    ([POCL_M2, APPLE], "m2", "several devices"),
    # More of the processor's name means the processor, under the preferred driver.
    ([POCL_XEON, INTEL_XEON], "intel xeon", POCL_XEON),
    ([POCL_XEON, INTEL_XEON], "xeon cpu", INTEL_XEON),
    ([POCL_ARM], "neoverse", POCL_ARM),
    # No maker's driver is there.
    ([POCL_XEON], "Intel", "'intel' is only the maker of a processor here, and 'cpu' asks for it"),
    ([POCL_6], "intel", "no device matches"),
    # Drivers by name.
    ([POCL_XEON, LLVMPIPE], "rusticl", LLVMPIPE),
    ([POCL_XEON, OCLGRIND], "oclgrind", OCLGRIND),
    ([RADEON_OF_MESA, LLVMPIPE], "rusticl gpu", RADEON_OF_MESA),
    # PoCL's version names LLVM and Linux, which are nobody's names.
    ([made_up.make_device("x", "cpu", made_up.POCL, platform_version="PoCL 3 Linux")], "linux", "no device matches"),
    # Identical cards are not ambiguous, and neither is a full name beside a longer one.
    ([GEFORCE, GEFORCE, POCL_3], "geforce", GEFORCE),
    ([RADEON, made_up.make_device("gfx1030G", "gpu", RADEON.platform)], "gfx1030", RADEON),
    ([RADEON, made_up.make_device("gfx1100", "gpu", RADEON.platform)], "gfx", "several devices"),
    (MACHINE, "intel", "several devices"),
    ([POCL_3], "gpu", "no device matches 'gpu'"),
]


def test_the_device_that_a_word_means():
    for machine, word, expected in MEANINGS:
        for devices in (machine, machine[::-1]):
            if isinstance(expected, str):
                with pytest.raises(DeviceError, match=expected):
                    pick_device(number_devices(devices), word)
            else:
                assert pick_device(number_devices(devices), word).name == expected.name, word


def test_the_environment_variable_decides_only_when_nothing_is_asked_for(monkeypatch):
    last = list_devices()[-1]
    monkeypatch.setenv("CLBVH_DEVICE", str(last.number))
    assert choose_device() == last
    monkeypatch.setenv("CLBVH_DEVICE", "riva tnt")
    with pytest.raises(DeviceError, match=r"'riva tnt' \(asked for by CLBVH_DEVICE\)"):
        choose_device()
    assert choose_device(last.number) == last
    monkeypatch.setenv("CLBVH_DEVICE", " ")
    assert choose_device() == list_devices()[0]


HOST_WORDS = ("host", " CPU ", "0", 0, np.int64(0))


@pytest.fixture
def machine(monkeypatch):
    """A function that puts this process on a machine with these devices; the host is the first, or broken."""

    def put(*devices, has_gpu_driver=True):
        def describe_host():
            if HOST not in devices:
                raise DeviceError("the compiled kernels are missing")
            return replace(HOST, number=0)

        asked = []

        def survey():
            asked.append(True)
            return DeviceSurvey(number_devices(devices), ())

        select._has_gpus.cache_clear()
        monkeypatch.delenv("CLBVH_DEVICE", raising=False)
        monkeypatch.setattr(select, "describe_host", describe_host)
        monkeypatch.setattr(select, "survey_devices", survey)
        monkeypatch.setattr(select, "may_serve_gpus", lambda: has_gpu_driver)
        return asked

    yield put
    select._has_gpus.cache_clear()


def test_the_host_is_chosen_without_a_look_at_other_devices(machine):
    asked = machine(HOST, POCL_6, has_gpu_driver=False)
    assert {choose_device(word).name for word in (None, *HOST_WORDS)} == {HOST.name}
    assert not asked
    assert choose_device("pocl").name == POCL_6.name


def test_a_gpu_is_the_default(machine):
    machine(HOST, POCL_6, GEFORCE, UHD)
    assert choose_device().name == GEFORCE.name
    assert {choose_device(word).name for word in HOST_WORDS} == {HOST.name}
    # A driver for GPUs without one of them.
    machine(HOST, POCL_6, OCLGRIND, EMULATOR, BROKEN_CARD)
    assert choose_device().name == HOST.name


def test_a_driver_serves_where_the_host_does_not(machine):
    for has_gpu_driver in (False, True):
        machine(OCLGRIND, POCL_3, has_gpu_driver=has_gpu_driver)
        assert {choose_device(word).name for word in (None, "cpu", 0, "pocl")} == {POCL_3.name}
        with pytest.raises(DeviceError, match="the compiled kernels are missing"):
            choose_device("host")
    machine()
    with pytest.raises(DeviceError, match=r"no device was found.*clbvh doctor"):
        choose_device()


def test_after_a_fork_the_host_is_the_default_unless_the_parent_has_had_a_gpu(machine, monkeypatch):
    for devices, refused in (([HOST, POCL_6, BROKEN_CARD], ["pocl"]), ([HOST, GEFORCE], ["gpu", None])):
        machine(*devices)
        choose_device()
        with monkeypatch.context() as patch:
            patch.setattr("clbvh.device.context._OpenCL.is_inherited", True)
            assert {choose_device(word).name for word in HOST_WORDS} == {HOST.name}
            for word in refused:
                with pytest.raises(DeviceError, match="forked"):
                    choose_device(word)
            if None not in refused:
                assert choose_device().name == HOST.name


def test_drivers_for_processors_alone_are_known_by_their_files(tmp_path, monkeypatch):
    monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path))
    monkeypatch.setattr(driver_files, "find_bundled_folder", lambda: None)
    for name in ("libpocl.so.2", "/opt/lib/libintelocl.so", "liboclgrind-rt-icd.so", ""):
        (tmp_path / "one.icd").write_text(f"{name}\n")
        assert sys.platform != "linux" or not may_serve_gpus()
    for name in ("libnvidia-opencl.so.1", "libRusticlOpenCL.so.1", "libMesaOpenCL.so.1", "/opt/pocl/libamdocl64.so"):
        (tmp_path / "two.icd").write_text(f"{name}\n")
        assert may_serve_gpus()


@pytest.mark.parametrize("word", ["gpu", "pocl", 1, "nvidia gpu"])
def test_without_pyopencl_the_host_is_there_and_one_sentence_says_what_is_not(monkeypatch, word):
    monkeypatch.setitem(sys.modules, "pyopencl", None)
    survey = survey_devices()
    assert [device.is_host for device in survey.devices] == [True]
    (problem,) = survey.problems
    assert problem.startswith("OpenCL needs pyopencl, which cannot be imported (imp")
    assert problem.endswith(": run `pip install pyopencl`")
    with pytest.raises(DeviceError) as raised:
        choose_device(word)
    assert str(raised.value) == f"no device matches '{word}': {problem}"


class FailingDevice:
    @property
    def name(self):
        raise cl.RuntimeError("clGetDeviceInfo", -33, "")


class Platform:
    version = "OpenCL 3.0"

    def __init__(self, name, devices):
        self.name, self._devices = name, devices

    def get_devices(self):
        if self._devices is None:
            raise cl.LogicError("clGetDeviceIDs", -32, "")
        return self._devices


def test_one_failing_platform_or_device_does_not_hide_the_others(monkeypatch):
    (real, *_) = cl.get_platforms()
    mixed = Platform(real.name, [FailingDevice(), *real.get_devices()])
    mixed.version = real.version
    monkeypatch.setattr(cl, "get_platforms", lambda: [Platform("Broken", None), Platform("rusticl", []), mixed])
    survey = survey_devices()
    assert len(survey.devices) == 1 + len(real.get_devices())
    assert "platform 0 cannot be asked" in survey.problems[0]
    assert survey.problems[1] == "the platform 'rusticl' offers no device"
    assert "cannot be described" in survey.problems[2]
