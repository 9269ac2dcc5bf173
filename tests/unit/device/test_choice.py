"""The order of the devices of made-up machines, and which of them a word means."""

import json
from itertools import permutations

import pytest

from clbvh.device.select import number_devices, pick_device
from clbvh.errors import DeviceError

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
    make_device,
)


def names_of(devices):
    return [device.name for device in devices]


def test_a_graphics_card_comes_first_then_the_one_inside_the_cpu_then_accelerators_then_cpus():
    shuffled = [POCL_3, IRIS, EMULATOR, BOARD, GEFORCE, RADEON]
    expected = [GEFORCE, RADEON, IRIS, BOARD, POCL_3, EMULATOR]
    assert names_of(number_devices(shuffled)) == names_of(expected)
    assert [device.number for device in number_devices(shuffled)] == [0, 1, 2, 3, 4, 5]


DRIVERS_OF_THE_CPU = [POCL_6, POCL_3, INTEL_CPU, make_device("EPYC", "cpu", "Some Driver"), LLVMPIPE, OCLGRIND]


def test_the_drivers_of_one_cpu_stand_in_the_order_that_was_measured_however_they_are_listed():
    for listed in permutations(DRIVERS_OF_THE_CPU):
        assert names_of(number_devices(listed)) == names_of(DRIVERS_OF_THE_CPU)


@pytest.mark.parametrize("turn", range(4))
def test_numbers_do_not_depend_on_the_order_of_the_platforms(turn):
    devices = [GEFORCE, POCL_6, POCL_3, INTEL_CPU]
    turned = devices[turn:] + devices[:turn]
    assert names_of(number_devices(turned)) == names_of(devices)


@pytest.mark.parametrize(
    ("measured", "expected"),
    [
        ({}, [POCL_6, POCL_3, INTEL_CPU, LLVMPIPE]),
        # One that was measured alone cannot be compared.
        ({INTEL_CPU: 1.0}, [POCL_6, POCL_3, INTEL_CPU, LLVMPIPE]),
        ({POCL_6: 5.0, INTEL_CPU: 4.0}, [INTEL_CPU, POCL_3, POCL_6, LLVMPIPE]),
        ({POCL_6: 4.0, INTEL_CPU: 5.0}, [POCL_6, POCL_3, INTEL_CPU, LLVMPIPE]),
        ({POCL_6: 4.0, POCL_3: 3.0, INTEL_CPU: 2.0, LLVMPIPE: 1.0}, [LLVMPIPE, INTEL_CPU, POCL_3, POCL_6]),
        # Equal times leave the order as it was.
        ({POCL_6: 4.0, INTEL_CPU: 4.0}, [POCL_6, POCL_3, INTEL_CPU, LLVMPIPE]),
    ],
)
def test_measured_devices_take_each_others_places(measured, expected):
    ms_of = {device.name + device.platform: ms for device, ms in measured.items()}
    ordered = number_devices(
        [LLVMPIPE, INTEL_CPU, POCL_3, POCL_6], lambda device: ms_of.get(device.name + device.platform)
    )
    assert names_of(ordered) == names_of(expected)
    assert [device.number for device in ordered] == [0, 1, 2, 3]


def test_no_measurement_puts_a_cpu_before_a_graphics_card_or_an_emulator_before_anything():
    ms_of = {UHD.name: 9.0, POCL_6.name: 1.0, OCLGRIND.name: 0.1}
    ordered = number_devices([POCL_6, UHD, OCLGRIND], lambda device: ms_of[device.name])
    assert names_of(ordered) == names_of([UHD, POCL_6, OCLGRIND])


def test_alike_devices_stay_in_the_drivers_order():
    first, second = (make_device("Tesla V100", "gpu", "NVIDIA CUDA", compute_units=n) for n in (80, 81))
    assert [device.compute_units for device in number_devices([first, second])] == [80, 81]
    assert [device.compute_units for device in number_devices([second, first])] == [81, 80]


def test_a_device_that_says_it_is_not_available_is_the_last_choice():
    broken = make_device("NVIDIA GeForce RTX 4090", "gpu", "NVIDIA CUDA", is_available=False)
    assert pick_device(number_devices([broken, POCL_3], lambda _: 1.0), None).name == POCL_3.name


MACHINE = number_devices([RADEON, GEFORCE, IRIS, BOARD, INTEL_CPU, POCL_6, POCL_3])


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        (None, GEFORCE),
        (0, GEFORCE),
        (1, RADEON),
        ("1", RADEON),
        (" 2 ", IRIS),
        ("gpu", GEFORCE),
        ("GPU", GEFORCE),
        ("accelerator", BOARD),
        ("cpu", POCL_6),
        ("geforce", GEFORCE),
        ("NVIDIA", GEFORCE),
        ("cuda", GEFORCE),
        ("4090", GEFORCE),
        ("amd", RADEON),
        ("amd accelerated", RADEON),
        ("iris", IRIS),
        ("Iris Xe", IRIS),
        ("iris(r) xe", IRIS),
        # Two versions of PoCL drive the same CPU: the newer one is taken.
        ("pocl", POCL_6),
        ("portable computing", POCL_6),
        ("epyc", POCL_6),
        # The full name of one device is a part of the names of others.
        ("AMD EPYC", INTEL_CPU),
        ("Intel(R) OpenCL", INTEL_CPU),
        ("pthread-", POCL_3),
        # A kind beside a name.
        ("intel gpu", IRIS),
        ("gpu intel", IRIS),
        ("Intel CPU", INTEL_CPU),
        ("amd gpu", RADEON),
        ("pocl cpu", POCL_6),
    ],
)
def test_the_device_that_a_specification_means(spec, expected):
    assert pick_device(MACHINE, spec).name == expected.name


@pytest.mark.parametrize(
    ("machine", "spec", "expected"),
    [
        # Makers: their driver or their card, never the processor under PoCL.
        ([POCL_XEON, INTEL_XEON], "intel", INTEL_XEON),
        ([POCL_XEON, INTEL_XEON], "Intel(R)", INTEL_XEON),
        ([POCL_XEON, UHD], "intel", UHD),
        ([POCL_XEON, UHD], "INTEL", UHD),
        ([POCL_XEON, INTEL_XEON, EMULATOR], "intel", INTEL_XEON),
        ([POCL_6, GEFORCE, RADEON], "amd", RADEON),
        ([POCL_6, RADEON_OF_MESA, LLVMPIPE], "amd", RADEON_OF_MESA),
        ([POCL_6, RADEON_OF_MESA, LLVMPIPE], "radeon", RADEON_OF_MESA),
        ([POCL_XEON, GEFORCE], "nvidia", GEFORCE),
        ([POCL_M2, APPLE], "apple", APPLE),
        ([POCL_M2, APPLE], "m2", None),
        # More of the processor's name means the processor, under the preferred driver.
        ([POCL_XEON, INTEL_XEON], "xeon", POCL_XEON),
        ([POCL_XEON, INTEL_XEON], "intel xeon", POCL_XEON),
        ([POCL_XEON, INTEL_XEON], "xeon cpu", INTEL_XEON),
        ([POCL_XEON], "sapphirerapids", POCL_XEON),
        ([POCL_ARM], "neoverse", POCL_ARM),
        # No maker's driver is there.
        ([POCL_XEON], "intel", None),
        ([POCL_XEON], "intel cpu", None),
        ([POCL_XEON], "intel gpu", None),
        ([POCL_6], "amd", None),
        ([POCL_ARM], "arm", None),
        ([POCL_M2], "apple", None),
        # Drivers by name.
        ([POCL_XEON, LLVMPIPE], "rusticl", LLVMPIPE),
        ([POCL_XEON, LLVMPIPE], "llvmpipe", LLVMPIPE),
        ([POCL_XEON, OCLGRIND], "oclgrind", OCLGRIND),
        ([POCL_XEON, OCLGRIND], "cpu", POCL_XEON),
        ([INTEL_XEON, EMULATOR], "emulation", EMULATOR),
        ([INTEL_XEON, EMULATOR], "accelerator", EMULATOR),
        ([RADEON_OF_MESA, LLVMPIPE], "rusticl gpu", RADEON_OF_MESA),
        # PoCL's version names LLVM and Linux, which are nobody's names.
        ([make_device("x", "cpu", "Portable Computing Language", platform_version="PoCL 3 Linux")], "linux", None),
    ],
)
def test_platforms_and_devices_are_matched_apart(machine, spec, expected):
    for devices in (machine, machine[::-1]):
        if expected is None:
            with pytest.raises(DeviceError):
                pick_device(number_devices(devices), spec)
        else:
            assert pick_device(number_devices(devices), spec).name == expected.name


def test_a_maker_whose_processor_alone_is_there_is_told_what_to_ask_for():
    with pytest.raises(DeviceError, match="'intel' is only the maker of a processor here, and 'cpu' asks for it"):
        pick_device(number_devices([POCL_XEON]), "Intel")
    with pytest.raises(DeviceError) as caught:
        pick_device(number_devices([POCL_6]), "intel")
    assert "maker" not in str(caught.value)


def test_the_full_name_is_not_ambiguous_beside_a_longer_one():
    devices = number_devices([make_device(name, "gpu", "NVIDIA CUDA") for name in ("Tesla T4G", "Tesla T4")])
    assert pick_device(devices, "tesla t4").name == "Tesla T4"


def test_identical_cards_are_not_ambiguous():
    devices = number_devices([GEFORCE, GEFORCE, POCL_3])
    assert pick_device(devices, "geforce").number == 0


def test_different_cards_of_one_maker_are_ambiguous():
    devices = number_devices([RADEON, make_device("gfx1100", "gpu", RADEON.platform), POCL_3])
    with pytest.raises(DeviceError, match="several devices"):
        pick_device(devices, "gfx")


@pytest.mark.parametrize(("spec", "fitting"), [("intel", [IRIS, INTEL_CPU]), ("opencl", [IRIS, INTEL_CPU])])
def test_a_part_that_fits_different_hardware_lists_what_it_fits(spec, fitting):
    with pytest.raises(DeviceError, match="several devices") as caught:
        pick_device(MACHINE, spec)
    for device in MACHINE:
        assert (str(device) in str(caught.value)) == (device.name in [fit.name for fit in fitting])


def test_the_vendor_of_the_cpu_does_not_make_the_graphics_card_ambiguous():
    pocl = make_device("cpu-znver4", "cpu", "Portable Computing Language", vendor="AuthenticAMD")
    assert pick_device(number_devices([pocl, RADEON]), "amd").name == RADEON.name


@pytest.mark.parametrize("spec", [7, -1, "7", "riva tnt", "custom", "gpu cpu", "riva gpu"])
def test_no_match_names_all_devices(spec):
    with pytest.raises(DeviceError) as caught:
        pick_device(MACHINE, spec)
    assert all(str(device) in str(caught.value) for device in MACHINE)
    assert str(spec) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_kind_that_is_not_there_is_no_match():
    with pytest.raises(DeviceError, match="no device matches 'gpu'"):
        pick_device(number_devices([POCL_3]), "gpu")


@pytest.mark.parametrize("device", MACHINE, ids=lambda device: device.kind)
def test_every_kind_has_a_layout(device):
    assert device.layout == ("bvh8" if device.kind == "cpu" else "bvh2")


def test_a_description_can_be_written_as_json_without_its_handle():
    facts = make_device("x", "gpu", "y", cl_device=object()).as_dict()
    assert json.loads(json.dumps(facts))["layout"] == "bvh2"
    assert "cl_device" not in facts
