"""Which device is taken: the rules on made-up machines, the survey on the drivers of this one."""

import json
import subprocess
import sys

import pytest

from clbvh.device.info import DeviceInfo
from clbvh.device.select import choose_device, list_devices, number_devices, pick_device, survey_devices
from clbvh.errors import DeviceError


def make_device(name, kind, platform, number=-1, **facts):
    """A description such as a driver would give; `number` is set by `number_devices`."""
    given = {
        "platform_version": "OpenCL 3.0",
        "vendor": "",
        "version": "OpenCL 3.0",
        "driver_version": "1.0",
        "memory_bytes": 8 << 30,
        "max_allocation_bytes": 2 << 30,
        "compute_units": 8,
        "has_fp64": True,
        "has_unified_memory": kind == "cpu",
    }
    return DeviceInfo(number=number, platform=platform, name=name, kind=kind, **(given | facts))


GEFORCE = make_device("NVIDIA GeForce RTX 4090", "gpu", "NVIDIA CUDA", memory_bytes=24 << 30)
RADEON = make_device("gfx1030", "gpu", "AMD Accelerated Parallel Processing", memory_bytes=16 << 30)
IRIS = make_device("Intel(R) Iris(R) Xe Graphics", "gpu", "Intel(R) OpenCL Graphics", has_unified_memory=True)
EMULATOR = make_device("Intel(R) FPGA Emulation Device", "accelerator", "Intel(R) FPGA Emulation Platform")
BOARD = make_device("Alveo U250", "accelerator", "Xilinx")
INTEL_CPU = make_device("AMD EPYC", "cpu", "Intel(R) OpenCL")
POCL_3 = make_device(
    "pthread-AMD EPYC",
    "cpu",
    "Portable Computing Language",
    platform_version="OpenCL 3.0 PoCL 3.0-rc2",
    driver_version="3.0-rc2",
)
POCL_6 = make_device(
    "cpu-znver4-AMD EPYC",
    "cpu",
    "Portable Computing Language",
    platform_version="OpenCL 3.0 PoCL 6.0",
    vendor="AuthenticAMD",
    driver_version="6.0",
)


def names_of(devices):
    return [device.name for device in devices]


def test_a_graphics_card_comes_first_then_the_one_inside_the_cpu_then_accelerators_then_cpus():
    shuffled = [POCL_3, IRIS, EMULATOR, BOARD, GEFORCE, RADEON]
    expected = [GEFORCE, RADEON, IRIS, BOARD, POCL_3, EMULATOR]
    assert names_of(number_devices(shuffled)) == names_of(expected)
    assert [device.number for device in number_devices(shuffled)] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("turn", range(4))
def test_numbers_do_not_depend_on_the_order_of_the_platforms(turn):
    devices = [GEFORCE, INTEL_CPU, POCL_6, POCL_3]
    turned = devices[turn:] + devices[:turn]
    assert names_of(number_devices(turned)) == names_of(devices)


def test_alike_devices_stay_in_the_drivers_order():
    first, second = (make_device("Tesla V100", "gpu", "NVIDIA CUDA", compute_units=n) for n in (80, 81))
    assert [device.compute_units for device in number_devices([first, second])] == [80, 81]
    assert [device.compute_units for device in number_devices([second, first])] == [81, 80]


def test_a_device_that_says_it_is_not_available_is_the_last_choice():
    broken = make_device("NVIDIA GeForce RTX 4090", "gpu", "NVIDIA CUDA", is_available=False)
    assert pick_device(number_devices([broken, POCL_3]), None).name == POCL_3.name


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
        ("cpu", INTEL_CPU),
        ("geforce", GEFORCE),
        ("NVIDIA", GEFORCE),
        ("4090", GEFORCE),
        ("amd accelerated", RADEON),
        ("iris", IRIS),
        # Two versions of PoCL drive the same CPU: the newer one is taken.
        ("pocl", POCL_6),
        ("portable computing", POCL_6),
        ("epyc", INTEL_CPU),
        # The full name of one device is a part of the names of others.
        ("AMD EPYC", INTEL_CPU),
        ("pthread-", POCL_3),
    ],
)
def test_what_a_specification_means(spec, expected):
    assert pick_device(MACHINE, spec).name == expected.name


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


@pytest.mark.parametrize("spec", ["intel", "opencl", "amd"])
def test_a_part_that_fits_different_hardware_lists_what_it_fits(spec):
    with pytest.raises(DeviceError, match="several devices") as caught:
        pick_device(MACHINE, spec)
    fitting = [d for d in MACHINE if spec in f"{d.name} {d.platform} {d.platform_version}".lower()]
    assert len(fitting) >= 2
    for device in MACHINE:
        assert (str(device) in str(caught.value)) == (device in fitting)


def test_the_vendor_of_the_cpu_does_not_make_the_graphics_card_ambiguous():
    pocl = make_device("cpu-znver4", "cpu", "Portable Computing Language", vendor="AuthenticAMD")
    assert pick_device(number_devices([pocl, RADEON]), "amd").name == RADEON.name


@pytest.mark.parametrize("spec", [7, -1, "7", "riva tnt", "custom"])
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


def test_the_devices_of_this_machine_describe_themselves():
    devices = list_devices()
    assert devices, "these tests need an OpenCL device; PoCL comes with the installation"
    assert [device.number for device in devices] == list(range(len(devices)))
    for device in devices:
        assert device.cl_device.name.split() == device.name.split()
        assert device.memory_bytes >= device.max_allocation_bytes > 0
        assert device.compute_units > 0
        assert device.version.startswith("OpenCL ")
        assert device.kind in {"gpu", "accelerator", "cpu", "other"}
    assert list_devices() == devices


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


def test_one_failing_platform_does_not_hide_the_others(monkeypatch):
    import pyopencl as cl

    class FailingPlatform:
        name = "Broken"

        def get_devices(self):
            raise cl.LogicError("clGetDeviceIDs", -32, "")

    class EmptyPlatform:
        name = "rusticl"

        def get_devices(self):
            return []

    real = cl.get_platforms()
    monkeypatch.setattr(cl, "get_platforms", lambda: [FailingPlatform(), EmptyPlatform(), *real])
    survey = survey_devices()
    assert len(survey.devices) == sum(len(platform.get_devices()) for platform in real)
    assert "platform 0 cannot be asked" in survey.problems[0]
    assert survey.problems[1:] == ("the platform 'rusticl' offers no device",)


def test_one_failing_device_does_not_hide_the_others(monkeypatch):
    import pyopencl as cl

    class FailingDevice:
        @property
        def name(self):
            raise cl.RuntimeError("clGetDeviceInfo", -33, "")

    real = cl.get_platforms()[0]

    class Platform:
        name = real.name
        version = real.version

        def get_devices(self):
            return [FailingDevice(), *real.get_devices()]

    monkeypatch.setattr(cl, "get_platforms", lambda: [Platform()])
    survey = survey_devices()
    assert len(survey.devices) == len(real.get_devices())
    assert len(survey.problems) == 1
    assert "cannot be described" in survey.problems[0]


def run_choice():
    """Choose a device in a fresh process: a loader reads its environment once."""
    code = """
from clbvh.device.select import choose_device, list_devices
from clbvh.errors import DeviceError
try:
    print("devices", len(list_devices()))
    choose_device()
except DeviceError as error:
    print(error)
"""
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return answer.stdout.splitlines()


def test_no_driver_at_all_points_to_the_doctor(tmp_path, monkeypatch):
    icd = tmp_path / "gone.icd"
    icd.write_text("libgone.so.1\n")
    monkeypatch.setenv("OCL_ICD_VENDORS", str(icd))
    assert run_choice() == [
        "devices 0",
        "no OpenCL device was found: run `clbvh doctor` to find the cause",
    ]


def test_a_loader_that_cannot_be_loaded_is_a_device_error(tmp_path, monkeypatch):
    broken = "raise ImportError('libOpenCL.so.1: cannot open shared object file')\n"
    (tmp_path / "pyopencl.py").write_text(broken)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (line,) = run_choice()
    assert line.startswith("pyopencl cannot be imported (libOpenCL.so.1: cannot open shared object file)")
    assert "clbvh doctor" in line
