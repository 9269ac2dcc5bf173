"""What tests of every kind share: a device, the real meshes, and the rule about skipping."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from clbvh.device.session import DeviceSession
from clbvh.errors import DeviceError

# The only reasons for which a test may skip where REQUIRE_DEVICE is set: what is missing is no part of the project.
_MAY_BE_MISSING = ("CLBVH_MESHES", "peers:")
REQUIRE_DEVICE = "CLBVH_REQUIRE_DEVICE"


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    """Turn a skip into a failure where an OpenCL device is promised."""
    outcome = yield
    report = outcome.get_result()
    if report.skipped and not hasattr(report, "wasxfail") and os.environ.get(REQUIRE_DEVICE):
        reason = str(call.excinfo.value)
        if not any(word in reason for word in _MAY_BE_MISSING):
            report.outcome = "failed"
            report.longrepr = f"{item.nodeid} skipped, but {REQUIRE_DEVICE} is set: {reason}"


@pytest.fixture(scope="session", autouse=True)
def _empty_cache(tmp_path_factory) -> Iterator[None]:
    """What the user keeps, settings of `clbvh tune` above all, is of no matter to tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CLBVH_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def _opened_device() -> Iterator[DeviceSession]:
    try:
        session = DeviceSession()
    except DeviceError as error:
        pytest.skip(f"no OpenCL device: {error}")
    with session:
        yield session


@pytest.fixture
def session(_opened_device: DeviceSession) -> DeviceSession:
    """The default device, opened once for all tests."""
    return _opened_device


@pytest.fixture(scope="session")
def real_mesh_path():
    """A function from a file name to its path in the folder of real meshes."""

    def find(name: str) -> Path:
        folder = os.environ.get("CLBVH_MESHES")
        path = Path(folder or "") / name
        if not folder or not path.is_file():
            pytest.skip(f"CLBVH_MESHES names no folder with {name}")
        return path

    return find
