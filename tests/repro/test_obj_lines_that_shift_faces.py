"""OBJ lines that took a vertex or the next line away without a word, so that later faces got wrong vertices."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import load_mesh
from clbvh.errors import MeshError

VERTICES = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"


@pytest.fixture
def load(tmp_path):
    def load_text(text: str):
        path = tmp_path / "a.obj"
        path.write_bytes(text.encode())
        mesh = load_mesh(path)
        return mesh.vertices.tolist(), mesh.faces.tolist()

    return load_text


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + VERTICES + "f 1 2 3\nf 2 3 4\n",
        VERTICES.replace("v 1", "# C:\\parts\\\nv 1") + "f 1 2 3\nf 2 3 4\n",
        VERTICES.replace("v 1", "v 1 0 0 # moved to \\\r\n#v 1") + "f 1 2 3\nf 2 3 4\n",
        VERTICES + "f 1 2 3 # from C:\\\nf 2 3 4",
        VERTICES.replace("\n", "\r\n") + "f 1 2 \\ \r\n 3\r\nf 2 3 4",
        VERTICES.replace("\n", "\r") + "f 1 2 3\rf 2 3 4",
        VERTICES.replace("v 1 0 0", "v \\\n 1 \\\n 0 0 0.5 0.5 0.5") + "f 1// 2//7 3/7\nf\t-3 -2 -1",
        VERTICES + "o one\nf 1 2 3\nvp 1 2 3\nvn 1 0 0\nvt 1 0\ng two#2\ns off\nfx 1\nl 1 2\np 1\nf +2 3 04",
    ],
    ids=[
        "byte-order-mark",
        "comment",
        "comment-behind-a-vertex",
        "comment-behind-a-face",
        "crlf",
        "cr",
        "joined",
        "others",
    ],
)
@pytest.mark.filterwarnings("ignore::clbvh.AppearanceWarning")  # of normals that are not there
def test_faces_keep_their_vertices(load, text):
    vertices, faces = load(text)
    assert vertices == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert faces == [[0, 1, 2], [1, 2, 3]]


@pytest.mark.parametrize("line", ["v\n", "v \n", "v", "v\t# 0 0 0\n", "v 1\n", "v 1 2\n", "v 1_0 0 0\n"])
@pytest.mark.parametrize("place", [0, 1])
def test_a_vertex_without_coordinates_is_refused(load, line, place):
    lines = VERTICES.splitlines(keepends=True)
    text = "".join([*lines[: 2 * place], line, "\n", *lines[2 * place :]])
    with pytest.raises(MeshError, match=r"vertex [02] is 'v.*', and not three coordinates"):
        load(text + "f 1 2 3\n")


@pytest.mark.parametrize(
    "face", ["f", "f \n", "f 1 2", "f 1 2 3_0", "f 1 2 3.0", "f 1 2 0x3", f"f 1 2 {'9' * 5000}", "f 1 2 ⅔"]
)
def test_a_face_that_is_none_is_refused(load, face):
    with pytest.raises(MeshError, match=r"corners|no vertex index|refers to vertex") as caught:
        load(VERTICES + "f 1 2 3\n" + face)
    assert "face 1 " in str(caught.value)


@pytest.mark.parametrize("statement", ["surf 0 1 0 1 1 2 3", "call part.obj", "fo 1 2 3"])
def test_a_surface_that_would_be_missing_is_refused_by_name(load, statement):
    with pytest.raises(MeshError, match=f"the statement '{statement.split()[0]}' is not read"):
        load(VERTICES + "f 1 2 3\n" + statement)


def test_digits_behind_those_of_float32_are_read(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 1000000.0001 0 0\nv 1000000.0002 0 0\nv 1000000.0001 0.0001 0\nf 1 2 3\n")
    mesh = load_mesh(path)
    assert np.ptp(mesh.vertices[:, 0]) == pytest.approx(1e-4, rel=1e-5)
