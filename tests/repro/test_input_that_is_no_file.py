"""A device was read without end, and a named pipe waited for: as a mesh, a scene, or a saved tree."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from clbvh import Bvh, load_mesh
from clbvh.errors import MeshError, SceneError, TreeFileError
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.rendering.open_scene import open_scene

TIMEOUT_S = 60


@pytest.fixture(params=["pipe", "device"])
def endless(request, tmp_path):
    """A path without a suffix that is a named pipe or a link to a device."""
    path = tmp_path / "a"
    if request.param == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    return path


READERS = {
    "mesh": (load_mesh, ".ply", MeshError),
    "scene": (open_scene, ".toml", SceneError),
    "tree": (lambda path: Bvh.load(path, make_shape("icosphere", triangles=20)), ".tree", TreeFileError),
}


@pytest.mark.parametrize("reader", READERS)
def test_it_is_refused_at_once(endless, reader):
    read, suffix, error = READERS[reader]
    path = endless.rename(endless.with_suffix(suffix))
    with pytest.raises(error, match=r"this is a (named pipe|device), not a file"):
        read(path)


def test_the_command_says_so_in_one_line(endless):
    """In a process of its own, with little memory, so that a command that reads on fails soon."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))"
    code = f"{limit}; from clbvh.cli import main; main()"
    run = subprocess.run(
        [sys.executable, "-c", code, "render", str(endless), "-o", str(endless.with_name("out.ppm"))],
        capture_output=True,
        check=False,
        text=True,
        timeout=TIMEOUT_S,
    )
    assert (run.returncode, len(run.stderr.splitlines())) == (2, 1)
    assert "not a file" in run.stderr
