"""The survey of the devices, on the drivers of this machine; the rules of the choice are in test_choice.py."""

import subprocess
import sys

import pytest

from clbvh.device.select import choose_device, list_devices, survey_devices
from clbvh.errors import DeviceError


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
