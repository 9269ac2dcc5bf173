"""Drivers that are registered for clbvh: which of them the loader is shown, and for how long."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clbvh.device import registered_drivers as module
from clbvh.device.icd_files import IcdFile, LoaderRule, find_bundled_folder
from clbvh.device.registered_drivers import find_offered, find_registered_folder, registered_drivers

TIMEOUT_S = 120


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine with one driver of the system's, and the rule of its loader; nothing has called the loader yet."""
    system, own, bundled = (tmp_path / name for name in ("system", "own", "bundled"))
    for folder in (system, own, bundled):
        folder.mkdir()
    (tmp_path / "libsystem.so.1.2").touch()
    (tmp_path / "libsystem.so.1").symlink_to("libsystem.so.1.2")
    (system / "system.icd").write_text(f"{tmp_path}/libsystem.so.1\n")
    (system / "bare.icd").write_text("libbare.so.3\n")
    rule = LoaderRule((system, own, bundled), bundled=bundled, registered=own)
    monkeypatch.setattr(module, "read_rule", lambda: rule)
    monkeypatch.setattr(module._Loader, "is_called", False)
    monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
    return rule


def register(rule: LoaderRule, name: str, library: Path | str) -> IcdFile:
    path = rule.registered / name
    path.write_text(f"{library}\n")
    return IcdFile(path, str(library))


def test_a_library_that_is_there_is_offered_and_one_that_is_gone_is_not(machine, tmp_path):
    (tmp_path / "libmine.so").touch()
    mine = register(machine, "mine.icd", tmp_path / "libmine.so")
    register(machine, "gone.icd", tmp_path / "libgone.so")
    register(machine, "folder.icd", tmp_path)
    register(machine, "empty.icd", "")
    register(machine, "relative.icd", "libmine.so")
    register(machine, "twice.icd", tmp_path / "libmine.so")
    assert find_offered(machine) == [mine]


@pytest.mark.parametrize("library", ["libsystem.so.1", "libsystem.so.1.2", "deeper/libbare.so.3"])
def test_a_library_that_the_loader_finds_by_itself_is_not_offered_again(machine, tmp_path, library):
    (tmp_path / library).parent.mkdir(exist_ok=True)
    (tmp_path / library).touch()
    register(machine, "again.icd", tmp_path / library)
    assert find_offered(machine) == []


def test_the_loader_sees_the_files_of_the_system_and_the_users_for_one_call(machine, tmp_path):
    (tmp_path / "libmine.so").touch()
    register(machine, "system.icd", tmp_path / "libmine.so")
    with registered_drivers():
        folder = Path(os.environ["OCL_ICD_VENDORS"])
        assert sorted(path.read_text() for path in folder.glob("*.icd")) == sorted(
            [f"{tmp_path}/libsystem.so.1\n", "libbare.so.3\n", f"{tmp_path}/libmine.so\n"]
        )
    assert "OCL_ICD_VENDORS" not in os.environ
    assert not folder.exists()


def test_nothing_happens_without_a_registered_driver_or_after_the_first_call(machine, tmp_path, monkeypatch):
    with registered_drivers():
        assert "OCL_ICD_VENDORS" not in os.environ
    (tmp_path / "libmine.so").touch()
    register(machine, "mine.icd", tmp_path / "libmine.so")
    monkeypatch.setattr(module._Loader, "is_called", True)
    with registered_drivers():
        assert "OCL_ICD_VENDORS" not in os.environ


def test_an_error_within_leaves_the_environment_as_it_was(machine, tmp_path):
    (tmp_path / "libmine.so").touch()
    register(machine, "mine.icd", tmp_path / "libmine.so")
    with pytest.raises(ZeroDivisionError), registered_drivers():
        raise ZeroDivisionError
    assert "OCL_ICD_VENDORS" not in os.environ


def test_the_loader_of_windows_gets_the_libraries_themselves(machine, tmp_path, monkeypatch):
    (tmp_path / "libmine.so").touch()
    register(machine, "mine.icd", tmp_path / "libmine.so")
    monkeypatch.setattr(module.sys, "platform", "win32")
    monkeypatch.setenv("OCL_ICD_FILENAMES", "other.dll")
    with registered_drivers():
        assert os.environ["OCL_ICD_FILENAMES"] == os.pathsep.join(["other.dll", f"{tmp_path}/libmine.so"])
    assert os.environ["OCL_ICD_FILENAMES"] == "other.dll"


def test_the_users_folder_is_named_by_a_variable_or_is_that_for_settings(monkeypatch, tmp_path):
    monkeypatch.setenv("CLBVH_DRIVERS", str(tmp_path))
    assert find_registered_folder() == tmp_path
    monkeypatch.setenv("CLBVH_DRIVERS", "")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    if sys.platform == "linux":
        assert find_registered_folder() == tmp_path / "config/clbvh/drivers"


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
    with registered_drivers():
        assert "OCL_ICD_VENDORS" not in os.environ
