"""Drivers that are registered for clbvh: which of them the loader is shown, and for how long."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clbvh.device import driver_files as module
from clbvh.device.driver_files import (
    DriverFile,
    added_drivers,
    find_added,
    find_bundled_folder,
    find_folders,
    find_registered_folder,
    read_driver_files,
)

TIMEOUT_S = 120


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine with two drivers of the system's; returns the folder for its user's."""
    system, own, bundled = (tmp_path / name for name in ("system", "own", "bundled"))
    for folder in (system, own, bundled):
        folder.mkdir()
    (tmp_path / "libsystem.so.1.2").touch()
    (tmp_path / "libsystem.so.1").symlink_to("libsystem.so.1.2")
    (system / "system.icd").write_text(f"{tmp_path}/libsystem.so.1\n")
    (system / "bare.icd").write_text("libbare.so.3\n")
    monkeypatch.setattr(module, "SYSTEM_VENDORS", system)
    monkeypatch.setattr(module, "_callers", [])
    monkeypatch.setattr(module, "find_bundled_folder", lambda: bundled)
    monkeypatch.setenv("CLBVH_DRIVERS", str(own))
    for variable in module.VENDOR_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    return own


def register(own: Path, name: str, library: Path | str) -> DriverFile:
    path = own / name
    path.write_text(f"{library}\n")
    return DriverFile(path, str(library))


def test_a_library_that_is_there_is_offered_and_one_that_is_gone_is_not(machine, tmp_path):
    (tmp_path / "libmine.so").touch()
    mine = register(machine, "mine.icd", tmp_path / "libmine.so")
    register(machine, "gone.icd", tmp_path / "libgone.so")
    register(machine, "folder.icd", tmp_path)
    register(machine, "empty.icd", "")
    register(machine, "relative.icd", "libmine.so")
    register(machine, "twice.icd", tmp_path / "libmine.so")
    assert find_added() == [mine]


@pytest.mark.parametrize("library", ["libsystem.so.1", "libsystem.so.1.2", "deeper/libbare.so.3"])
def test_a_library_that_the_loader_finds_by_itself_is_not_offered_again(machine, tmp_path, library):
    (tmp_path / library).parent.mkdir(exist_ok=True)
    (tmp_path / library).touch()
    register(machine, "again.icd", tmp_path / library)
    assert find_added() == []


def test_the_loader_sees_the_files_of_the_system_and_the_users_for_one_call(machine, tmp_path):
    (tmp_path / "libmine.so").touch()
    register(machine, "system.icd", tmp_path / "libmine.so")
    with added_drivers():
        folder = Path(os.environ["OCL_ICD_VENDORS"])
        assert sorted(path.read_text() for path in folder.glob("*.icd")) == sorted(
            [f"{tmp_path}/libsystem.so.1\n", "libbare.so.3\n", f"{tmp_path}/libmine.so\n"]
        )
    assert "OCL_ICD_VENDORS" not in os.environ
    assert not folder.exists()


def test_nothing_happens_without_a_registered_driver_or_after_the_first_call(machine):
    with added_drivers():
        assert "OCL_ICD_VENDORS" not in os.environ
    register(machine, "mine.icd", __file__)
    with added_drivers():
        assert "OCL_ICD_VENDORS" not in os.environ


def test_an_error_within_leaves_the_environment_as_it_was(machine, tmp_path):
    (tmp_path / "libmine.so").touch()
    register(machine, "mine.icd", tmp_path / "libmine.so")
    with pytest.raises(ZeroDivisionError), added_drivers():
        raise ZeroDivisionError
    assert "OCL_ICD_VENDORS" not in os.environ


def test_the_users_folder_is_named_by_a_variable_or_is_that_for_settings(monkeypatch, tmp_path):
    monkeypatch.setenv("CLBVH_DRIVERS", str(tmp_path))
    assert find_registered_folder() == tmp_path
    monkeypatch.setenv("CLBVH_DRIVERS", "")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    if sys.platform == "linux":
        assert find_registered_folder() == tmp_path / "config/clbvh/drivers"


@pytest.mark.parametrize("variable", module.VENDOR_VARIABLES)
def test_a_variable_replaces_the_folders_but_not_the_loaders_own(machine, tmp_path, monkeypatch, variable):
    system, own, bundled = find_folders()
    assert (system.name, own, bundled.name) == ("system", machine, "bundled")
    monkeypatch.setenv(variable, str(tmp_path))
    assert find_folders() == [tmp_path, bundled]
    register(machine, "mine.icd", __file__)
    assert find_added() == []


def test_the_loader_of_a_conda_environment_reads_the_environment(machine, tmp_path, monkeypatch):
    monkeypatch.setattr(module.sys, "prefix", str(tmp_path))
    assert find_folders()[0].name == "system"
    monkeypatch.setattr(module, "find_bundled_folder", lambda: None)
    (tmp_path / "etc/OpenCL/vendors").mkdir(parents=True)
    assert find_folders() == [tmp_path / "etc/OpenCL/vendors", machine]


def test_driver_files_are_read_as_the_loader_reads_them(machine, tmp_path, monkeypatch):
    monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path / "system"))
    (tmp_path / "bundled/libpocl.so").touch()
    (tmp_path / "bundled/pocl.icd").write_text("libpocl.so\n")
    (tmp_path / "system/odd.icd").write_text("liba.so \r\nsecond line\n")
    (tmp_path / "system/folder.icd").mkdir()
    assert [(file.path.name, file.library) for file in read_driver_files()] == [
        ("bare.icd", "libbare.so.3"),
        ("folder.icd", ""),
        ("odd.icd", "liba.so \r"),
        ("system.icd", f"{tmp_path}/libsystem.so.1"),
        ("pocl.icd", str(tmp_path / "bundled/libpocl.so")),
    ]


def test_the_files_of_this_machine_are_those_that_its_loader_reads(tmp_path, monkeypatch):
    if find_bundled_folder() is None:
        pytest.skip("this pyopencl has no loader of its own whose rules could be compared")
    (tmp_path / "gone.icd").write_text("libgone.so.7\n")
    monkeypatch.setenv("OCL_ICD_DEBUG", "15")
    for value in (str(tmp_path), str(tmp_path / "gone.icd"), str(tmp_path / "nothing")):
        monkeypatch.setenv("OCL_ICD_VENDORS", value)
        code = "import pyopencl as cl\ntry: cl.get_platforms()\nexcept cl.Error: pass"
        answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
        opened = {line.split("'")[1] for line in answer.stderr.splitlines() if "Loading ICD '" in line}
        assert {Path(name).name for name in opened} == {Path(file.library).name for file in read_driver_files()}


LIST = """
import os
from clbvh.device.select import list_devices
print(len(list_devices()), len(list_devices()))
assert "OCL_ICD_VENDORS" not in os.environ
"""


def list_in_a_process(own: Path) -> subprocess.CompletedProcess:
    """Count the devices in a process without a variable that names drivers; its loader reports what it reads."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("OCL_", "OPENCL_"))}
    environment = kept | {"CLBVH_DRIVERS": str(own), "OCL_ICD_DEBUG": "15"}
    process = subprocess.run(
        [sys.executable, "-c", LIST], env=environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    assert process.returncode == 0, process.stderr
    return process


def test_the_real_loader_is_led_to_a_registered_library_without_any_variable(tmp_path):
    if find_bundled_folder() is None:
        pytest.skip("this pyopencl has no loader of its own, so its words are unknown")
    own = tmp_path / "drivers"
    own.mkdir()
    library = tmp_path / "libmine.so"
    library.write_text("no library at all")
    alone = list_in_a_process(own)
    assert str(library) not in alone.stderr
    (own / "mine.icd").write_text(f"{library}\n")
    shown = list_in_a_process(own)
    # It is refused, and harms none of the others.
    assert f"Loading ICD '{library}'" in shown.stderr
    assert shown.stdout == alone.stdout


def test_the_pocl_that_is_there_already_is_not_listed_twice(tmp_path):
    bundled = find_bundled_folder()
    pocl = next(iter(bundled.glob("libpocl*")), None) if bundled else None
    if pocl is None:
        pytest.skip("this pyopencl has no PoCL beside it that could be registered again")
    own = tmp_path / "drivers"
    own.mkdir()
    alone = list_in_a_process(own)
    (tmp_path / "libpocl.so.2").symlink_to(pocl)
    (own / "pocl.icd").write_text(f"{tmp_path}/libpocl.so.2\n")
    assert list_in_a_process(own).stdout == alone.stdout


def test_without_a_folder_for_temporary_files_the_loader_keeps_the_systems_drivers(machine, tmp_path, monkeypatch):
    (tmp_path / "libmine.so").touch()
    register(machine, "mine.icd", tmp_path / "libmine.so")
    monkeypatch.setattr(module.tempfile, "tempdir", str(tmp_path / "no such folder"))
    with added_drivers():
        assert "OCL_ICD_VENDORS" not in os.environ
