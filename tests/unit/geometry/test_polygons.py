"""Polygons to triangles: order, winding, and faces that are only edges."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import load_mesh
from clbvh.errors import AppearanceWarning, MeshError
from clbvh.geometry.loading.file_mesh import cut_fans
from clbvh.geometry.loading.load import load_parts
from clbvh.support import memory


def test_polygons_become_fans_where_they_stand():
    corners = np.array([0, 1, 2, 0, 2, 4, 6, 1, 2, 3, 4, 5, 5, 6, 7])
    faces = cut_fans(corners, np.array([3, 4, 5, 3]))
    assert faces.tolist() == [[0, 1, 2], [0, 2, 4], [0, 4, 6], [1, 2, 3], [1, 3, 4], [1, 4, 5], [5, 6, 7]]


def test_no_polygons_are_no_triangles():
    assert cut_fans(np.empty(0, int), np.empty(0, int)).shape == (0, 3)


@pytest.mark.parametrize("size", [0, 1, 2])
def test_a_polygon_with_too_few_corners_has_no_triangles(size):
    corners = np.arange(7 + size)
    assert cut_fans(corners, np.array([3, size, 4])).tolist() == [
        [0, 1, 2],
        [3 + size, 4 + size, 5 + size],
        [3 + size, 5 + size, 6 + size],
    ]
    assert len(cut_fans(corners[:size], np.array([size]))) == 0


def test_triangles_that_do_not_fit_the_memory_are_refused_before_they_are_cut(monkeypatch):
    """A corner may be a single byte of a file, a triangle is 24 in memory."""
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 1 << 28)
    with pytest.raises(MeshError, match="1,999,998 triangles need about 300 MB of memory"):
        cut_fans(np.zeros(2_000_000, np.int64), np.array([2_000_000]))


HEADER = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 3\nproperty list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n"
    "property uchar blue\nend_header\n"
)
CORNERS = "0 0 0\n1 0 0\n0 1 0\n"
EDGED = {
    "a.ply": f"{HEADER}{CORNERS}3 0 1 2 255 0 0\n2 0 1 0 255 0\n3 2 1 0 0 0 255\n",
    "a.off": f"OFF\n3 3 0\n{CORNERS}3 0 1 2 255 0 0\n2 0 1 0 255 0\n3 2 1 0 0 0 255\n",
    "a.obj": "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl r\nf 1 2 3\nusemtl g\nf 1 2\nusemtl b\nf 3 2 1\n",
}


@pytest.mark.parametrize("name", EDGED)
def test_edges_among_the_faces_are_left_out_and_the_others_keep_their_colours(tmp_path, name):
    (tmp_path / "a.mtl").write_text("newmtl r\nKd 1 0 0\nnewmtl g\nKd 0 1 0\nnewmtl b\nKd 0 0 1\n")
    (tmp_path / name).write_text(EDGED[name])
    with pytest.warns(AppearanceWarning, match=r"1 of 3 faces have fewer than three corners, and are left out$"):
        mesh = load_mesh(tmp_path / name)
    assert mesh.faces.tolist() == [[0, 1, 2], [2, 1, 0]]
    looks = mesh.appearance
    if looks.colours is None:
        colours = [looks.materials[number].base_colour for number in looks.material_ids]
    else:
        colours = looks.colours[:, 0]
    assert np.argmax(np.array(colours)[:, :3], axis=1).tolist() == [0, 2]


def test_objects_of_edges_are_no_parts(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\no a\nf 1 2 3\no b\nf 1 2\no c\nf 3 2 1\nf 2 3\n")
    with pytest.warns(AppearanceWarning, match="2 of 4 faces"):
        meshes, _ = load_parts(path)
    assert [(mesh.name, mesh.face_count) for mesh in meshes] == [("a", 1), ("c", 1)]
