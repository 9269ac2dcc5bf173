"""PoCL 3.0 aborted the process at the first kernel on a machine without `ld`, or without the files of gcc and libc."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import clbvh
from clbvh.device import pocl_linker
from clbvh.device.select import number_devices

from ..cli.command import refuses, run_process
from ..unit.device.made_up_devices import INTEL_CPU, POCL_3

NO_LINKER = "without the linker `ld`"


@pytest.fixture
def bare(tmp_path):
    """The environment of a machine with no program on its path, and nothing compiled yet."""
    if pocl_linker.explain_missing_linker("3.0-rc2"):
        pytest.skip("this machine has no linker")
    folders = {name: tmp_path / name for name in ("POCL_CACHE_DIR", "CLBVH_CACHE")}
    for folder in folders.values():
        folder.mkdir()
    return {"PATH": "/nonexistent"} | {name: str(folder) for name, folder in folders.items()}


def test_a_render_ends_with_one_line_that_has_the_remedy_and_doctor_says_it(bare, tmp_path):
    if any(device.driver_version != "3.0-rc2" for device in clbvh.list_devices()):
        pytest.skip("a driver of this machine links by itself")
    answer = run_process("render", "demo", "-o", tmp_path / "out.ppm", **bare)
    refuses(answer, 3, NO_LINKER, "apt-get install binutils libc6-dev libgcc-12-dev", "clbvh doctor --fix")
    assert not (tmp_path / "out.ppm").exists()
    answer = run_process("devices", "--json", **bare)
    assert answer.returncode == 3
    assert [device["is_available"] for device in json.loads(answer.stdout)["devices"]] == [False]
    answer = run_process("doctor", "--json", **bare)
    assert answer.returncode == 3
    (problem,) = [finding for finding in json.loads(answer.stdout)["findings"] if NO_LINKER in finding["message"]]
    assert any("apt-get install" in line for line in problem["advice"])


def test_the_check_before_an_installation_needs_no_package(bare):
    script = [sys.executable, "-I", "-S", pocl_linker.__file__]
    said = subprocess.run(script, env=bare, capture_output=True, text=True, check=False)
    has_driver = any(Path("/etc/OpenCL/vendors").glob("*.icd"))
    assert (said.returncode, NO_LINKER in said.stderr) == ((0, False) if has_driver else (1, True))


def test_a_driver_that_needs_no_linker_comes_first_and_no_other_driver_is_refused(monkeypatch):
    monkeypatch.setenv("PATH", "/nonexistent")
    monkeypatch.setattr(pocl_linker, "_LIBRARY_FOLDERS", ())
    monkeypatch.setattr(pocl_linker, "_GCC_PREFIXES", ())
    monkeypatch.setattr(pocl_linker, "_find_missing", pocl_linker._find_missing.__wrapped__)  # without its cache
    assert all(part in pocl_linker.explain_missing_linker("3.0-rc2") for part in ("`ld`", "libgcc", "libc's"))
    assert pocl_linker.explain_missing_linker("7.1") == pocl_linker.explain_missing_linker(INTEL_CPU.version) == ""
    first, second = number_devices([replace(POCL_3, is_available=False), INTEL_CPU])
    assert (first.platform, second.platform) == (INTEL_CPU.platform, POCL_3.platform)
