"""The wheel and the editable install, each in an environment of its own, used from another folder.

The environments borrow the packages that clbvh needs from the one that runs the tests, so that nothing is downloaded.
They do not borrow clbvh: a path in a `.pth` file is not searched for further `.pth` files, which is how an editable
install is found.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
SCENE = '[mesh]\nshape = "icosphere"\ntriangles = 320\n[image]\nwidth = 40\nheight = 30\n'


def make_environment(folder: Path) -> Path:
    """Make an environment without clbvh and return its python."""
    venv.create(folder, with_pip=True, symlinks=True)
    python = folder / "bin" / "python"
    paths = subprocess.check_output([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], text=True)
    (Path(paths.strip()) / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    assert subprocess.run([python, "-c", "import clbvh.cli"], capture_output=True, cwd=folder).returncode != 0
    return python


def install(python: Path, *what: object) -> None:
    words = [python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", *what]
    subprocess.run(words, check=True, capture_output=True)


@pytest.fixture(scope="module", params=["wheel", "editable"])
def installed(request, tmp_path_factory):
    """An environment with clbvh in it: its python."""
    folder = tmp_path_factory.mktemp(request.param)
    python = make_environment(folder / "environment")
    if request.param == "editable":
        install(python, "--editable", REPOSITORY)
    else:
        words = ["wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, REPOSITORY]
        subprocess.run([sys.executable, "-m", "pip", *words], check=True, capture_output=True)
        install(python, *folder.glob("clbvh-*.whl"))
    return request.param, python


def test_it_renders_from_another_folder(installed, tmp_path):
    _, python = installed
    (tmp_path / "scene.toml").write_text(SCENE)
    command = [python.with_name("clbvh"), "render", "scene.toml", "-o", "out.ppm", "--validate"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "out.ppm").read_bytes().startswith(b"P6")


def test_kernels_and_scenes_come_from_where_they_should(installed, tmp_path):
    kind, python = installed
    code = "from clbvh.resources import find_folder as f; print(f('cl')); print(f('scenes'))"
    folders = subprocess.check_output([python, "-c", code], cwd=tmp_path, text=True).split()
    if kind == "editable":
        assert folders == [str(REPOSITORY / "cl"), str(REPOSITORY / "scenes")]
    else:
        assert all(Path(folder).is_relative_to(python.parents[1]) for folder in folders)
        for folder in folders:
            source = REPOSITORY / Path(folder).name
            assert {p.relative_to(folder) for p in Path(folder).rglob("*.*")} == {
                p.relative_to(source) for p in source.rglob("*.*")
            }
