"""The wheel and the editable install, each in an environment of its own, used from another folder.

The environments borrow the packages that clbvh needs from the one that runs the tests, so that nothing is downloaded.
They do not borrow clbvh: a path in a `.pth` file is not searched for further `.pth` files, which is how an editable
install is found.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
SCENE = '[mesh]\nshape = "icosphere"\ntriangles = 320\n[image]\nwidth = 40\nheight = 30\n'

# Imports every module, those that run as a script by another name than `__main__` as well.
IMPORT_ALL = """
import importlib, pkgutil, clbvh
for module in pkgutil.walk_packages(clbvh.__path__, "clbvh."):
    importlib.import_module(module.name)
    print(module.name)
"""

# Passes where numba can be imported and clbvh cannot.
NOTHING_BUT_PACKAGES = """
import importlib.util
assert importlib.util.find_spec("numba")
try:
    import clbvh.errors
except ImportError:
    pass
else:
    raise SystemExit(f"clbvh is here already: {clbvh.errors}")
"""

# A path here would offer the tests' own clbvh to the environments.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def call(*words: object, folder: Path | None = None) -> str:
    """Run a program, and return its output."""
    process = subprocess.run(
        list(map(str, words)), cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


def make_environment(folder: Path) -> Path:
    """Make an environment without clbvh and without pip; return its python."""
    venv.create(folder, symlinks=True)
    python = folder / "bin" / "python"
    packages = Path(call(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
    (packages / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    call(python, "-c", NOTHING_BUT_PACKAGES, folder=folder)
    return python


def run_pip(*words: object) -> None:
    """Run the tests' own pip, without a network."""
    call(sys.executable, "-m", "pip", "--disable-pip-version-check", *words)


def install(python: Path, *words: object) -> None:
    run_pip("--python", python, "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", *words)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The path of the wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    run_pip("wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, REPOSITORY)
    (path,) = folder.glob("clbvh-*.whl")
    return path


@pytest.fixture(scope="module")
def installed_wheel(wheel, tmp_path_factory):
    """The python of an environment with the wheel."""
    python = make_environment(tmp_path_factory.mktemp("from-wheel") / "environment")
    install(python, wheel)
    return python


@pytest.fixture(scope="module")
def installed_editable(tmp_path_factory):
    """The python of an environment with the editable install."""
    python = make_environment(tmp_path_factory.mktemp("editable") / "environment")
    install(python, "--editable", REPOSITORY)
    return python


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def files_of(root: Path, *parts: str) -> dict[str, bytes]:
    """Return the content of all files below some folders of the repository, by path, without Python's own."""
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for part in parts
        for path in (root / part).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_the_wheel_has_every_file_of_the_package_and_no_other(wheel):
    sources = files_of(REPOSITORY, "clbvh")
    sources |= {f"clbvh/{name}": content for name, content in files_of(REPOSITORY, "cl", "scenes").items()}
    with zipfile.ZipFile(wheel) as archive:
        packed = {name: archive.read(name) for name in archive.namelist() if ".dist-info/" not in name}
    assert packed.keys() == sources.keys()
    assert packed == sources


def test_every_module_of_the_wheel_can_be_imported(installed_wheel, tmp_path):
    names = call(installed_wheel, "-c", IMPORT_ALL, folder=tmp_path).split()
    modules = {path.relative_to(REPOSITORY).with_suffix("") for path in (REPOSITORY / "clbvh").rglob("*.py")}
    expected = {".".join(path.parts).removesuffix(".__init__") for path in modules}
    assert {"clbvh", *names} == expected


def test_the_wheel_renders_from_another_folder(installed_wheel, scene, tmp_path):
    # Without a tree: machine code belongs to a path, and compiling the builder again for this one takes half a minute.
    command = [installed_wheel.with_name("clbvh"), "render", scene, "-o", "out.ppm", "--builder", "brute"]
    call(*command, folder=tmp_path)
    assert (tmp_path / "out.ppm").read_bytes().startswith(b"P6")


def test_the_editable_install_renders_from_another_folder(installed_editable, scene, tmp_path):
    command = [installed_editable.with_name("clbvh"), "render", scene, "-o", "out.ppm", "--validate"]
    assert "agree with the reference" in call(*command, folder=tmp_path)
    assert (tmp_path / "out.ppm").read_bytes().startswith(b"P6")


FIND_FOLDERS = "from clbvh.support.resources import find_folder as f; print(f('cl')); print(f('scenes'))"


def test_the_wheel_finds_kernels_and_scenes_in_itself(installed_wheel, tmp_path):
    folders = [Path(line) for line in call(installed_wheel, "-c", FIND_FOLDERS, folder=tmp_path).splitlines()]
    package = Path(call(installed_wheel, "-c", "import clbvh; print(clbvh.__file__)", folder=tmp_path).strip()).parent
    assert folders == [package / "cl", package / "scenes"]
    assert package.is_relative_to(installed_wheel.parents[1])


def test_the_editable_install_finds_kernels_and_scenes_in_the_repository(installed_editable, tmp_path):
    folders = call(installed_editable, "-c", FIND_FOLDERS, folder=tmp_path).split()
    assert folders == [str(REPOSITORY / "cl"), str(REPOSITORY / "scenes")]
