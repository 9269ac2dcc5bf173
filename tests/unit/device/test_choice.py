"""The devices of made-up machines and of this one: their order, and which of them a word means."""

from dataclasses import replace

import pyopencl as cl
import pytest

from clbvh import DeviceError, choose_device, list_devices
from clbvh.device.select import _keep_distinct, number_devices, pick_device, survey_devices

from . import made_up_devices as made_up
from .made_up_devices import (
    APPLE,
    BOARD,
    EMULATOR,
    GEFORCE,
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


def test_a_graphics_card_comes_first_then_the_one_inside_the_cpu_then_accelerators_then_cpus():
    expected = [GEFORCE, RADEON, IRIS, BOARD, POCL_3, EMULATOR]
    ordered = number_devices([POCL_3, IRIS, EMULATOR, BOARD, GEFORCE, RADEON])
    assert names_of(ordered) == names_of(expected)
    assert [device.number for device in ordered] == list(range(6))


def test_measured_devices_take_each_others_places():
    usual = [POCL_6, POCL_3, INTEL_CPU, LLVMPIPE]
    for measured, expected in [
        ({}, usual),
        # One that was measured alone cannot be compared, and equal times leave the order as it was.
        ({INTEL_CPU: 1.0}, usual),
        ({POCL_6: 4.0, INTEL_CPU: 4.0}, usual),
        ({POCL_6: 5.0, INTEL_CPU: 4.0}, [INTEL_CPU, POCL_3, POCL_6, LLVMPIPE]),
        ({POCL_6: 4.0, POCL_3: 3.0, INTEL_CPU: 2.0, LLVMPIPE: 1.0}, usual[::-1]),
    ]:
        times = {device.name + device.platform: ms for device, ms in measured.items()}
        ordered = number_devices(usual[::-1], lambda device, times=times: times.get(device.name + device.platform))
        assert names_of(ordered) == names_of(expected)
    # None puts a CPU before a graphics card or an emulator before anything.
    times = {UHD.name: 9.0, POCL_6.name: 1.0, OCLGRIND.name: 0.1}
    ordered = number_devices([POCL_6, UHD, OCLGRIND], lambda device: times[device.name])
    assert names_of(ordered) == names_of([UHD, POCL_6, OCLGRIND])


def test_all_devices_are_the_cards_under_one_driver_each_or_the_cpu():
    radeons = replace(RADEON, vendor="Advanced Micro Devices, Inc."), replace(RADEON_OF_MESA, vendor="AMD")
    for machine, expected in [
        ([GEFORCE, GEFORCE, POCL_6], [GEFORCE, GEFORCE]),
        ([POCL_6, *radeons, IRIS, GEFORCE, LLVMPIPE], [GEFORCE, radeons[0], IRIS]),
        ([POCL_3, INTEL_CPU, POCL_6, OCLGRIND], [POCL_6]),
        ([EMULATOR, replace(GEFORCE, is_available=False)], []),
    ]:
        assert names_of(_keep_distinct(number_devices(machine))) == names_of(expected)


MACHINE = number_devices([RADEON, GEFORCE, IRIS, BOARD, INTEL_CPU, POCL_6, POCL_3])
MEANINGS = [
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
    assert len(survey.devices) == len(real.get_devices())
    assert "platform 0 cannot be asked" in survey.problems[0]
    assert survey.problems[1] == "the platform 'rusticl' offers no device"
    assert "cannot be described" in survey.problems[2]
