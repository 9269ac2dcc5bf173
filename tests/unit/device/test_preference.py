"""The order of the devices of made-up machines."""

from itertools import permutations

import pytest

from clbvh.device.select import number_devices, pick_device

from .made_up_devices import (
    BOARD,
    EMULATOR,
    GEFORCE,
    INTEL_CPU,
    IRIS,
    LLVMPIPE,
    OCLGRIND,
    POCL_3,
    POCL_6,
    RADEON,
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
