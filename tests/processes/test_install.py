"""The wheel and the editable install, each in an environment of its own, used from another folder; and the Dockerfile.

The environments borrow the packages that clbvh needs from the one that runs the tests, so that nothing is downloaded.
They do not borrow clbvh: a path in a `.pth` file is not searched for further `.pth` files, which is how an editable
install is found.
"""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from email import message_from_bytes
from email.message import Message
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
SCENE = '[[object]]\nshape = "icosphere"\ntriangles = 320\n[view]\nwidth = 40\nheight = 30\n'


# Passes where numpy can be imported and clbvh cannot.
NOTHING_BUT_PACKAGES = """
import importlib.util
assert importlib.util.find_spec("numpy")
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


def test_both_installs_render_from_another_folder(installed_wheel, installed_editable, tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    call(installed_wheel.with_name("clbvh"), "render", "scene.toml", "-o", "out.ppm", folder=tmp_path)
    command = [installed_editable.with_name("clbvh"), "render", "scene.toml", "-o", "tree.ppm", "--validate"]
    assert "agree with the reference" in call(*command, folder=tmp_path)
    assert (tmp_path / "out.ppm").read_bytes().startswith(b"P6")
    assert (tmp_path / "tree.ppm").read_bytes().startswith(b"P6")


def test_kernels_and_scenes_are_found_in_the_wheel_and_in_the_repository(installed_wheel, installed_editable, tmp_path):
    code = "from clbvh.support.folders import find_folder as f; print(f('cl')); print(f('scenes'))"
    package = installed_wheel.parents[1] / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}"
    for python, root in ((installed_wheel, package / "site-packages" / "clbvh"), (installed_editable, REPOSITORY)):
        assert call(python, "-c", code, folder=tmp_path).split() == [str(root / "cl"), str(root / "scenes")]


def test_a_type_checker_sees_the_types_of_the_installed_package(installed_wheel, tmp_path):
    (tmp_path / "program.py").write_text(
        "import clbvh\n"
        "reveal_type(clbvh.build(clbvh.make_shape('knot', triangles=80)).nodes)\n"
        "clbvh.build(clbvh.make_shape('knot', triangles=80), builder=3)\n"
    )
    command = [sys.executable, "-m", "mypy", "--python-executable", installed_wheel, "--no-incremental", "program.py"]
    process = subprocess.run(command, cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    nodes, error = process.stdout.splitlines()[:2]
    assert "ndarray" in nodes, process.stdout
    assert "arg-type" in error


def read_metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return message_from_bytes(archive.read(name))


def test_the_wheel_has_its_license_and_no_dead_link(wheel):
    metadata = read_metadata(wheel)
    assert metadata["License-Expression"] == "MIT"
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith("licenses/LICENSE"))
        assert b"the clbvh developers" in archive.read(name)
    # Nobody has published the project yet, so there is no address, and nothing in the README may lead to one.
    assert metadata.get_all("Project-URL") is None
    text = metadata.get_payload(decode=True).decode()
    assert text.startswith("# clbvh")
    assert [address for address in re.findall(r"\]\(([^)]+)\)", text) if not address.startswith("https://")] == []


def test_with_the_address_of_a_repository_links_and_pictures_are_absolute(tmp_path, monkeypatch):
    monkeypatch.setitem(ENVIRONMENT, "CLBVH_PROJECT_URL", "https://example.org/clbvh/")
    run_pip("wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path, REPOSITORY)
    metadata = read_metadata(next(tmp_path.glob("*.whl")))
    urls = dict(entry.split(", ", 1) for entry in metadata.get_all("Project-URL"))
    assert urls["Homepage"] == "https://example.org/clbvh"
    assert set(urls) == {"Homepage", "Documentation", "Changelog", "Issues"}
    text = metadata.get_payload(decode=True).decode()
    addresses = re.findall(r"\]\(([^)]+)\)", text)
    assert all(address.startswith("https://") for address in addresses)
    own = [address.partition("/main/")[2] for address in addresses if address.startswith(urls["Homepage"])]
    assert own
    assert [path for path in own if not (REPOSITORY / path.partition("#")[0]).exists()] == []


def test_the_source_distribution_has_what_a_build_and_the_tests_need(tmp_path):
    # hatchling itself builds it: pip makes no source distribution.
    call(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", tmp_path, folder=REPOSITORY)
    (path,) = tmp_path.glob("clbvh-*.tar.gz")
    with tarfile.open(path) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
        archive.extractall(tmp_path / "unpacked", filter="data")
    for part in ("clbvh", "cl", "scenes", "tests", "docs", "examples", ".ci", ".github", "bench", "recipe"):
        assert {name for name in files_of(REPOSITORY, part) if not name.startswith("clbvh/compiled/")} <= names
    assert {"README.md", "LICENSE", "CHANGELOG.md", "Makefile", "Dockerfile", "hatch_build.py"} <= names
    assert {"RELEASING.md", "CITATION.cff"} <= names
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    run_pip("wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path, unpacked)
    assert list(tmp_path.glob("*.whl"))


def test_the_image_lists_a_device_and_renders_for_any_user(tmp_path):
    if shutil.which("docker") is None:
        pytest.skip("docker: not installed")
    if subprocess.run(["docker", "info"], capture_output=True, check=False).returncode:
        pytest.skip("docker: there is no daemon that this user may talk to")
    call("docker", "build", "--tag", "clbvh-test", REPOSITORY)
    run = ["docker", "run", "--rm", "--user", "12345:12345", "--volume", f"{tmp_path}:/data", "clbvh-test"]
    assert " host " in call("docker", "run", "--rm", "clbvh-test")
    tmp_path.chmod(0o777)
    call(*run, "render", "demo", "-o", "out.ppm")
    assert (tmp_path / "out.ppm").read_bytes().startswith(b"P6")
