"""PoCL 3.0 aborted the process at the first kernel on a machine without `ld`, or without the files of gcc and libc."""

import json

import pytest

import clbvh
from clbvh import DeviceError
from clbvh.device import pocl_3

from ..cli.command import refuses, run_process
from ..unit.device.made_up_devices import INTEL_CPU, POCL_3, POCL_6

NO_LINKER = "without the linker `ld`"


@pytest.fixture
def bare(tmp_path):
    """The environment of a machine with no program on its path, and nothing compiled yet."""
    if not any(device.driver_version == POCL_3.driver_version for device in clbvh.list_devices()):
        pytest.skip("this machine has no PoCL 3.0")
    folders = {name: tmp_path / name for name in ("POCL_CACHE_DIR", "CLBVH_CACHE")}
    for folder in folders.values():
        folder.mkdir()
    return {"PATH": "/nonexistent"} | {name: str(folder) for name, folder in folders.items()}


def test_pocl_is_refused_by_one_line_that_has_the_remedy_and_the_host_works(bare, tmp_path):
    picture = tmp_path / "out.ppm"
    words = ("render", "demo", "--width", "40", "--height", "30", "-o", picture)
    answer = run_process(*words, "--device", "pocl", **bare)
    refuses(answer, 3, NO_LINKER, "install gcc", "host")
    assert not picture.exists()
    assert run_process(*words, **bare).returncode == 0
    assert picture.exists()
    answer = run_process("doctor", "--json", **bare)
    assert answer.returncode == 0
    (problem,) = [finding for finding in json.loads(answer.stdout)["findings"] if NO_LINKER in finding["message"]]
    assert any("apt install gcc" in line for line in problem["advice"])


def test_all_that_is_missing_is_named_and_no_other_driver_is_refused(monkeypatch):
    monkeypatch.setenv("PATH", "/nonexistent")
    monkeypatch.setattr(pocl_3, "_LIBRARY_FOLDERS", ())
    monkeypatch.setattr(pocl_3, "_GCC_PREFIXES", ())
    monkeypatch.setattr(pocl_3, "_find_missing", pocl_3._find_missing.__wrapped__)  # without its cache
    with pytest.raises(DeviceError, match="`ld`, gcc's `libgcc`, libc's"):
        pocl_3.prepare_pocl_3(POCL_3)
    for other in (POCL_6, INTEL_CPU):
        pocl_3.prepare_pocl_3(other)
