"""Words that were no numbers, and numbers too many, were left out of an ASCII PLY file without a word."""

import pytest

from clbvh import load_mesh
from clbvh.errors import MeshError

HEADER = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""


def read(tmp_path, vertices):
    path = tmp_path / "a.ply"
    path.write_text(f"{HEADER}{vertices}\n3 0 1 2\n")
    return load_mesh(path)


@pytest.mark.parametrize(
    "line",
    [
        "0 1 0,7",
        "0 1 0 abc",
        "0 1 0 9",
        "0 1",
        "0 1 -",
        "0 1 --5",
        "0 1 1.5.5",
        "0 1 1e",
        "0 1 1e+",
        "0 1 .",
        "0 1 0x10",
    ],
)
def test_they_are_refused(tmp_path, line):
    for vertices in (f"0 0 0\n1 0 0\n{line}", f"0 0 0\n{line}\n1 0 0"):
        with pytest.raises(MeshError):
            read(tmp_path, vertices)


@pytest.mark.parametrize("number", ["1", "+1", "1.", ".5", "-.5", "1.5e3", "1E-3", "1.e+3", "0.1", "  2", "2\t", "2 "])
def test_numbers_of_every_form_are_read(tmp_path, number):
    mesh = read(tmp_path, f"0 0 0\n1 0 0\n0 1 {number}")
    assert mesh.vertices[2, 2] == pytest.approx(float(number), rel=1e-7)


@pytest.mark.parametrize("face", ["4 0 1 - 2 0", "4 0 1 2 +", "3 0 + 1 2"])
def test_a_sign_without_a_number_is_no_part_of_the_next_one(tmp_path, face):
    path = tmp_path / "a.ply"
    path.write_text(f"{HEADER}0 0 0\n1 0 0\n0 1 0\n{face}\n")
    with pytest.raises(MeshError):
        load_mesh(path)
