"""`clbvh devices`: the table, the JSON object, and machines that lack something, each in a process of its own."""

import json
import re

import pytest

from clbvh.errors import DeviceError

from .command import hidden_drivers, refuses, run_clbvh, run_process, shadowed_modules


@pytest.fixture(scope="module")
def listed():
    """The answer of `clbvh devices --json` on this machine."""
    answer = run_clbvh("devices", "--json")
    assert answer.returncode == 0
    return json.loads(answer.stdout)["devices"]


def test_the_json_object_describes_every_device(listed):
    import pyopencl as cl

    drivers_say = sorted(
        (" ".join(device.name.split()), device.global_mem_size, device.max_compute_units)
        for platform in cl.get_platforms()
        for device in platform.get_devices()
    )
    assert sorted((d["name"], d["memory_bytes"], d["compute_units"]) for d in listed) == drivers_say
    assert [device["number"] for device in listed] == list(range(len(listed)))
    assert [device["number"] for device in listed if device["is_default"]] == [0]
    assert {device["layout"] for device in listed if device["kind"] == "cpu"} <= {"bvh8"}


def test_the_table_has_a_line_for_every_device_and_marks_the_default(listed):
    answer = run_clbvh("devices")
    assert answer.returncode == 0
    heading, *lines, footer = answer.stdout.splitlines()
    assert footer.startswith("* used by default")
    assert heading.split() == ["device", "platform", "version", "driver", "memory", "units", "fp64", "layout"]
    for device, line in zip(listed, lines, strict=True):
        mark = "* " if device["is_default"] else ""
        assert line.strip().startswith(f"{mark}{device['number']} ")
        for fact in ("name", "kind", "platform", "driver_version", "layout"):
            assert device[fact] in line


def test_names_with_brackets_are_printed_as_they_are(monkeypatch, capsys):
    from dataclasses import replace

    from clbvh.cli.devices import devices
    from clbvh.device import select

    named = replace(select.list_devices()[0], name="Graphics [bold]", is_available=False)
    monkeypatch.setattr(select, "survey_devices", lambda: select.DeviceSurvey((named,), ()))
    monkeypatch.delenv("CLBVH_DEVICE", raising=False)
    with pytest.raises(DeviceError, match="no OpenCL device can be used"):
        devices(as_json=False)
    assert "* 0  Graphics [bold] (not available) " in capsys.readouterr().out


@pytest.mark.parametrize("columns", [40, 80])
def test_a_narrow_terminal_has_a_list_with_whole_words(columns, monkeypatch, capsys):
    from clbvh.cli.devices import devices
    from clbvh.device import select

    found = select.list_devices()[:1]
    monkeypatch.setattr(select, "survey_devices", lambda: select.DeviceSurvey(tuple(found), ()))
    monkeypatch.delenv("CLBVH_DEVICE", raising=False)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", str(columns))
    devices(as_json=False)
    output = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    assert max(map(len, output.splitlines())) <= columns
    words = output.split()
    for word in (*found[0].name.split(), *found[0].platform.split(), found[0].kind, "fp64", "units,"):
        assert word in words or f"{word}," in words


def test_a_wrong_choice_in_the_environment_is_named_but_does_not_hide_the_list():
    answer = run_clbvh("devices", "--json", CLBVH_DEVICE="riva tnt")
    assert answer.returncode == 0
    listed = json.loads(answer.stdout)["devices"]
    assert listed
    assert not any(device["is_default"] for device in listed)
    assert "'riva tnt' (asked for by CLBVH_DEVICE)" in answer.stderr


@pytest.mark.parametrize("arguments", [(), ("--json",)])
def test_no_driver_is_exit_code_3_and_one_line_that_points_to_the_doctor(tmp_path, arguments):
    answer = run_process("devices", *arguments, **hidden_drivers(tmp_path))
    assert answer.returncode == 3
    (line,) = answer.stderr.splitlines()
    assert "no OpenCL device was found" in line
    assert "clbvh doctor" in line
    if arguments:
        assert json.loads(answer.stdout) == {"devices": [], "problems": []}
    else:
        assert answer.stdout == ""


def test_a_platform_without_devices_is_named(tmp_path):
    # A folder that PoCL cannot make: below a file.
    (tmp_path / "file").touch()
    answer = run_process("devices", "--json", POCL_CACHE_DIR=str(tmp_path / "file/cache"))
    problem = "the platform 'Portable Computing Language' offers no device"
    assert problem in json.loads(answer.stdout)["problems"]
    assert problem in answer.stderr


def test_pyopencl_that_cannot_be_imported_is_exit_code_3_without_a_traceback(tmp_path):
    broken = "raise ImportError('libOpenCL.so.1: cannot open shared object file')\n"
    (tmp_path / "pyopencl.py").write_text(broken)
    refuses(run_process("devices", **shadowed_modules(tmp_path)), 3, "libOpenCL.so.1", "clbvh doctor")
