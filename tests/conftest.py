"""Shared by all tests: a device, sources of rays, tracers, the cache of compiled code, the rule about skipping.

Fixtures with the scope of the session are made by the first test that asks for them; no test changes them.
"""

from __future__ import annotations

import os
import random
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings
from platformdirs import user_cache_dir

from . import profiles

if TYPE_CHECKING:
    from clbvh import Mesh, Scene, Tracer
    from clbvh.device.session import DeviceSession

# The only reasons for which a test may skip where REQUIRE_DEVICE is set: missing things that are no part of the
# project.
_MAY_BE_MISSING = ("CLBVH_MESHES", "docker:", "peers:", "compilers for GPUs:", "browser:")
REQUIRE_DEVICE = "CLBVH_REQUIRE_DEVICE"

# The device of the suite, and that of tests with the marks below, which need an OpenCL driver.
SUITE_DEVICE = os.environ.get("CLBVH_TEST_DEVICE") or "host"
OPENCL_DEVICE = "pocl" if SUITE_DEVICE == "host" else SUITE_DEVICE

# PoCL compiles a kernel in 1 to 5 s, so it gets what an OpenCL device does otherwise than the host, and not all else.
_MARKS = {
    "on_both": "run on the host and on an OpenCL device: kernels, queries against the oracle, builds, images",
    "on_opencl": "run on an OpenCL device alone: its contexts, queues, arrays, compiler and errors",
}

_OUT = Path(__file__).parents[1] / "out"

# `--hypothesis-profile` comes later and wins.
settings.load_profile(profiles.SHORT)

# All workers, runs and processes of their own share what PoCL compiles, and what clang has compiled for the
# installation, however a test sets `CLBVH_CACHE`.
(_OUT / "cache" / "pocl").mkdir(parents=True, exist_ok=True)
os.environ.setdefault("POCL_CACHE_DIR", str(_OUT / "cache" / "pocl"))
os.environ.setdefault("CLBVH_OBJECTS", str(Path(user_cache_dir("clbvh", appauthor=False)) / "objects"))


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config) -> None:
    """Choose the seed of a long run, unless the command line has it, before hypothesis looks at it."""
    for name, meaning in _MARKS.items():
        config.addinivalue_line("markers", f"{name}: {meaning}")
    if config.getoption("--hypothesis-profile") == profiles.LONG:
        if config.option.hypothesis_seed is None:
            config.option.hypothesis_seed = random.randrange(2**32)
        profiles.RunSeed.value = int(config.option.hypothesis_seed)


def _list_devices(test) -> list[str]:
    """Return the devices that a test or function of a test runs on, by its marks."""
    if test.get_closest_marker("on_opencl"):
        return [OPENCL_DEVICE]
    return list(dict.fromkeys((SUITE_DEVICE, OPENCL_DEVICE))) if test.get_closest_marker("on_both") else []


def pytest_generate_tests(metafunc) -> None:
    """Give tests with a mark their devices, where they ask for a device."""
    devices = _list_devices(metafunc.definition)
    if devices and "_opened_device" in metafunc.fixturenames:
        metafunc.parametrize("_opened_device", devices, indirect=True, scope="session")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item) -> None:
    """Make a test's device the default one, before any of its fixtures is there."""
    parameters = item.callspec.params if hasattr(item, "callspec") else {}
    os.environ["CLBVH_DEVICE"] = parameters.get("_opened_device") or (_list_devices(item) or [SUITE_DEVICE])[0]


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
    """Hide the user's cache: trees and meshes there must not change a test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CLBVH_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def _opened_device(request: pytest.FixtureRequest) -> Iterator[DeviceSession]:
    from clbvh import DeviceError
    from clbvh.device.open import open_device

    name = getattr(request, "param", SUITE_DEVICE)
    try:
        session = open_device(name)
    except DeviceError as error:
        pytest.skip(f"no device {name}: {error}")
    with session:
        yield session


@pytest.fixture
def session(_opened_device: DeviceSession) -> DeviceSession:
    """The device, opened once for all tests; under the mark `on_both` both, one after the other."""
    return _opened_device


@pytest.fixture(scope="session")
def mesh() -> Mesh:
    """A closed knot of 1,800 triangles in the device's own coordinates: the oracle judges what the device is given."""
    from clbvh import make_shape

    from .rays import centred

    return centred(make_shape("knot", triangles=1800))


@pytest.fixture(scope="session")
def world(mesh: Mesh) -> Scene:
    """The knot in its own place, and around it a sheared mirror image, a far small copy, and spheres."""
    from clbvh import Scene, Spheres

    scene = Scene(mesh)
    knot = scene.geometries[0]
    scene.place(knot, [[-1, 0.5, 0, 3], [0, 1, 0.25, 0], [0, 0, 2, 1], [0, 0, 0, 1]])
    scene.place(knot, [[0, -0.25, 0, -2], [0.25, 0, 0, 2], [0, 0, 0.25, 0], [0, 0, 0, 1]], mask=2)
    generator = np.random.default_rng(32)
    scene.place(scene.add(Spheres(generator.uniform(-2, 2, (20, 3)), generator.uniform(0.05, 0.4, 20))))
    return scene


@pytest.fixture(scope="session", params=["mesh", "world"])
def source(request: pytest.FixtureRequest) -> Mesh | Scene:
    """Both, one after the other: for tests that must hold for a lone mesh and for instances."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def rays(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """3,072 rays in a random order that are hard for the knot: origins and directions."""
    from .rays import hard_rays

    origins, directions = hard_rays(mesh, 3072, np.random.default_rng(30))
    order = np.random.default_rng(31).permutation(len(origins))
    return origins[order], directions[order]


@pytest.fixture(scope="session")
def open_tracer(_opened_device: DeviceSession) -> Iterator[Callable[..., Tracer]]:
    """A function from a source and options to its `Tracer`, opened once for the same object and options."""
    from clbvh import Tracer

    opened: dict[tuple[object, ...], tuple[object, Tracer]] = {}

    def find(source: object, **options: object) -> Tracer:
        key = (id(source), *sorted(options.items()))
        if key not in opened:
            # The source is kept, too, so that its id stays its own.
            opened[key] = source, Tracer(source, device=_opened_device.info, **options)
        return opened[key][1]

    yield find
    for _, tracer in opened.values():
        tracer.close()


@pytest.fixture(scope="session")
def tracer(open_tracer: Callable[..., Tracer], mesh: Mesh) -> Tracer:
    """The tracer of the knot."""
    return open_tracer(mesh)


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
def traffic(_opened_device: DeviceSession, monkeypatch) -> list[int]:
    """The bytes of each transfer between host and device since the test began."""
    sizes: list[int] = []
    kind = type(_opened_device)
    write, download = kind.write, kind.download

    def note_write(self, buffer, array, **how):
        sizes.append(array.nbytes)
        write(self, buffer, array, **how)

    def note_download(self, buffer, into, **how):
        sizes.append(into.nbytes)
        download(self, buffer, into, **how)

    monkeypatch.setattr(kind, "write", note_write)
    monkeypatch.setattr(kind, "download", note_download)
    return sizes


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A temporary folder with a short name: a socket in it must fit the 108 bytes that Unix has for its path."""
    with tempfile.TemporaryDirectory(prefix="clbvh-") as folder:
        yield Path(folder)
