"""Files that were read wrong, read without end, or ended in a traceback."""

import os
import subprocess
import sys

import numpy as np
import pytest

import clbvh
from clbvh import Bvh, ConfigError, MeshError, SceneError, TreeFileError, load_mesh, open_scene
from clbvh.rendering.scene_file import read_scene_file

from ..unit.geometry.test_stl_off import facet, make_stl

VERTICES = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""
TRIANGLES = 1e-9 * np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]])


@pytest.fixture
def write(tmp_path):
    """A function that writes a file and returns its path."""

    def write(name, content):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


@pytest.mark.filterwarnings("ignore::clbvh.AppearanceWarning")  # of normals that are not there
def test_obj_lines_took_a_vertex_or_the_next_line_away(write):
    for text in (
        "\ufeff" + VERTICES + "f 1 2 3\nf 2 3 4\n",
        VERTICES.replace("v 1", "# C:\\parts\\\nv 1") + "f 1 2 3\nf 2 3 4\n",
        VERTICES.replace("v 1", "v 1 0 0 # moved to \\\r\n#v 1") + "f 1 2 3\nf 2 3 4\n",
        VERTICES.replace("\n", "\r\n") + "f 1 2 \\ \r\n 3\r\nf 2 3 4",
        VERTICES.replace("v 1 0 0", "v \\\n 1 \\\n 0 0 0.5 0.5 0.5") + "f 1// 2//7 3/7\nf\t-3 -2 -1",
        VERTICES + "o one\nf 1 2 3\nvp 1 2 3\nvn 1 0 0\nvt 1 0\ng two#2\ns off\nfx 1\nl 1 2\np 1\nf +2 3 04",
    ):
        mesh = load_mesh(write("a.obj", text))
        assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], text
        assert mesh.faces.tolist() == [[0, 1, 2], [1, 2, 3]], text


def test_obj_vertices_and_faces_that_are_none_were_left_out(write):
    lines = VERTICES.splitlines(keepends=True)
    for line in ("v", "v\t# 0 0 0\n", "v 1 2\n", "v 1_0 0 0\n"):
        text = "".join([*lines[:2], line, "\n", *lines[2:], "f 1 2 3\n"])
        with pytest.raises(MeshError, match=r"vertex 2 is 'v.*', and not three coordinates"):
            load_mesh(write("a.obj", text))
    for face in ("f", "f 1 2", "f 1 2 3_0", "f 1 2 3.0", f"f 1 2 {'9' * 5000}", "f 1 2 ⅔"):
        with pytest.raises(MeshError, match=r"face 1 "):
            load_mesh(write("a.obj", VERTICES + "f 1 2 3\n" + face))
    for statement in ("surf 0 1 0 1 1 2 3", "call part.obj"):
        with pytest.raises(MeshError, match=f"the statement '{statement.split()[0]}' is not read"):
            load_mesh(write("a.obj", VERTICES + "f 1 2 3\n" + statement))


def test_ply_words_that_were_no_numbers_were_left_out(write):
    for line in ("0 1 0,7", "0 1 0 abc", "0 1", "0 1 -", "0 1 --5", "0 1 1.5.5", "0 1 1e+", "0 1 0x10"):
        with pytest.raises(MeshError):
            load_mesh(write("a.ply", f"{PLY}0 0 0\n{line}\n1 0 0\n3 0 1 2\n"))
    for face in ("4 0 1 - 2 0", "4 0 1 2 +", "3 0 + 1 2"):
        with pytest.raises(MeshError):
            load_mesh(write("a.ply", f"{PLY}0 0 0\n1 0 0\n0 1 0\n{face}\n"))
    for number in ("1", "+1", "1.", ".5", "-.5", "1.5e3", "1E-3", "1.e+3", "  2", "2\t"):
        mesh = load_mesh(write("a.ply", f"{PLY}0 0 0\n1 0 0\n0 1 {number}\n3 0 1 2\n"))
        assert mesh.vertices[2, 2] == pytest.approx(float(number), rel=1e-7)


def make_text(triangles):
    return "".join(f"solid part\n{facet(triangle.tolist())}endsolid part\n" for triangle in triangles)


def make_binary(triangles):
    return make_stl(0, b"solid of two", triangles)


@pytest.mark.parametrize("make", [make_text, make_binary])
def test_stl_corners_nearer_than_a_tolerance_were_merged_whatever_the_unit(write, make):
    mesh = load_mesh(write("a.stl", make(TRIANGLES)))
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]
    assert mesh.vertices[mesh.faces] == pytest.approx(TRIANGLES, rel=1e-6, abs=1e-16)
    # One unit in the last place is a difference.
    moved = TRIANGLES.astype(np.float32)
    moved[1, 0, 0] = np.nextafter(moved[1, 0, 0], np.float32(1))
    assert load_mesh(write("a.stl", make(moved.astype(np.float64)))).faces.tolist() == [[0, 1, 2], [3, 4, 2]]


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_device_was_read_without_end_and_a_pipe_waited_for(tmp_path, mesh, kind):
    endless = tmp_path / "a"
    os.mkfifo(endless) if kind == "pipe" else endless.symlink_to("/dev/zero")
    # A process of its own, with little memory, so that a command that reads on fails soon.
    limit = "import resource; resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))"
    command = [sys.executable, "-c", f"{limit}; from clbvh.cli import main; main()", "render", endless]
    run = subprocess.run([*command, "-o", tmp_path / "out.ppm"], capture_output=True, text=True, timeout=60)
    assert (run.returncode, len(run.stderr.splitlines())) == (2, 1)
    assert "not a file" in run.stderr
    for suffix, read, error in (
        (".ply", load_mesh, MeshError),
        (".toml", open_scene, SceneError),
        (".tree", lambda path: Bvh.load(path, mesh), TreeFileError),
    ):
        endless = endless.rename(endless.with_suffix(suffix))
        with pytest.raises(error, match=r"this is a (named pipe|device), not a file"):
            read(endless)


def test_numbers_of_a_scene_without_bound_ended_in_a_traceback(write, monkeypatch):
    for shape in ("knot", "terrain", "blobs", "boxes", "icosphere", "palace"):
        text = f'[[object]]\nshape = "{shape}"\ntriangles = 2147483648'
        with pytest.raises(SceneError, match=f"the shape '{shape}' cannot be made: .* triangles are too many"):
            read_scene_file(write("a.toml", text))
    for line in (
        "triangles = 9e18", "triangles = 9223372036854775808", f"triangles = 0x{'f' * 10_000}", "size = inf",
        f"triangles = {'9' * 5000}", f"size = 1{'0' * 400}", "size = 1e400", f"size = {'[' * 5000}",
    ):  # fmt: skip
        with pytest.raises(SceneError) as caught:
            read_scene_file(write("a.toml", f'[[object]]\nshape = "blobs"\n{line}\n'))
        assert len(str(caught.value)) < 1000
    with pytest.raises(MeshError, match=r"not finite|float"):
        read_scene_file(write("a.toml", '[[object]]\nshape = "blobs"\nspread = 1e308\n'))
    # Refused as before, but numpy warned of it on the terminal.
    boxes = '[[object]]\nshape = "boxes"\ntriangles = 12\nspread = 1000\nscale = 1.7e308\n'
    with pytest.raises(SceneError, match="float64 has no room"):
        clbvh.render(write("a.toml", boxes), width=8, height=8)
    with pytest.raises(SceneError, match="more than the 1,048,576 expected"):
        read_scene_file(write("a.toml", "#" * (1 << 20) + "\n"))
    monkeypatch.setattr("clbvh.support.memory.free_memory_bytes", lambda: 10**9)
    with pytest.raises(ConfigError, match="10,000,000 triangles need about 1,500 MB of memory, but 1,000 MB are free"):
        clbvh.make_shape("knot", triangles=10_000_000)
