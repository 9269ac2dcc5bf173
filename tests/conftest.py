"""Shared by all tests: a device, the real meshes, the folder of machine code, and the rule about skipping."""

from __future__ import annotations

import os
import random
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from clbvh.support.folders import CACHE_VARIABLE, find_cache

from . import profiles

if TYPE_CHECKING:
    from clbvh.device.session import DeviceSession

# The only reasons for which a test may skip where REQUIRE_DEVICE is set: missing things that are no part of the
# project.
_MAY_BE_MISSING = ("CLBVH_MESHES", "docker:", "peers:", "compilers for GPUs:")
REQUIRE_DEVICE = "CLBVH_REQUIRE_DEVICE"

# `--hypothesis-profile` comes later and wins.
settings.load_profile(profiles.SHORT)

# All processes of a run share the user's machine code, however a test sets `CLBVH_CACHE`. numba reads this when it is
# imported, so nothing above may import it.
os.environ.setdefault("NUMBA_CACHE_DIR", str(find_cache() / "compiled"))


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config) -> None:
    """Choose the seed of a long run, unless the command line has it, before hypothesis looks at it."""
    if config.getoption("--hypothesis-profile") == profiles.LONG:
        if config.option.hypothesis_seed is None:
            config.option.hypothesis_seed = random.randrange(2**32)
        profiles.RunSeed.value = int(config.option.hypothesis_seed)


def pytest_report_header(config) -> str | None:
    """Show the seed of a long run."""
    if profiles.is_long():
        return f"seed {profiles.RunSeed.value}: repeat this run by `make test-long SEED={profiles.RunSeed.value}`"
    return None


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
    """Hide the user's cache: settings of `clbvh tune`, trees and meshes there must not change a test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session", autouse=True)
def _most_host_rays() -> Iterator[int]:
    """Cast few rays on the device, too: most tests have few, and are there for the device's kernels."""
    from clbvh.trace import launch

    shipped = launch.MOST_HOST_RAYS
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(launch, "MOST_HOST_RAYS", 0)
        yield shipped


@pytest.fixture
def host_casts_few(_most_host_rays: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cast few rays on the host, as outside of tests."""
    from clbvh.trace import launch

    monkeypatch.setattr(launch, "MOST_HOST_RAYS", _most_host_rays)


@pytest.fixture(scope="session")
def _opened_device() -> Iterator[DeviceSession]:
    from clbvh.device.session import DeviceSession
    from clbvh.errors import DeviceError

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


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A temporary folder with a short name: a socket in it must fit the 108 bytes that Unix has for its path."""
    with tempfile.TemporaryDirectory(prefix="clbvh-") as folder:
        yield Path(folder)
