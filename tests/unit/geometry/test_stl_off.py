"""STL files, text and binary, with colours of both kinds; and OFF files with their looks."""

import numpy as np
import pytest

import clbvh
from clbvh.geometry.appearance.srgb import linear_to_srgb

TRIANGLES = np.float32(
    [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]]
)
DEFAULT = [*np.rint(linear_to_srgb(clbvh.Material().base_colour) * 255).astype(int).tolist(), 255]
VERTICES = ["0 0 0", "2 0 0", "2 1 0", "0 1 0"]
FACES = "4 0 1 2 3\n3 2 1 0\n"
CUT = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0]])


@pytest.fixture
def load(tmp_path):
    def load_content(content):
        (tmp_path / "file").write_bytes(content if isinstance(content, bytes) else content.encode())
        return clbvh.load_mesh(tmp_path / "file")

    return load_content


def make_stl(attributes, header=b"", triangles=TRIANGLES):
    rows = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows["corners"], rows["attribute"] = triangles, attributes
    return header.ljust(80, b"\0") + len(rows).to_bytes(4, "little") + rows.tobytes()


def facet(corners, normal="0 0 1"):
    inner = "\n".join(f"   vertex {x} {y} {z}" for x, y, z in corners)
    return f" facet normal {normal}\n  outer loop\n{inner}\n  endloop\n endfacet\n"


def pack(first, second, third):
    return first | second << 5 | third << 10


def test_text_with_several_solids_and_a_binary_file_that_begins_with_solid(load):
    a, b, c = TRIANGLES
    text = f"solid facet vertex\n{facet(a)}{facet(b, '-nan(ind) nan nan')}endsolid\n"
    text += f"SOLID two\n{facet(c).upper()}ENDSOLID two"
    for content in (text, make_stl([0, 0, 0], b"solid thing")):
        mesh = load(content)
        assert mesh.vertices[mesh.faces].tolist() == TRIANGLES.tolist()
        assert len(mesh.vertices) == 5


def test_colours_of_triangles(load):
    mark, first, last = 0x8000, pack(0, 16, 31), pack(31, 0, 0)
    magics = b"by hand COLOR=" + bytes([9, 8, 7, 200]) + b",MATERIAL="
    own = [9, 8, 7, 200]
    for attributes, header, expected in (
        # Marked ones run from blue to red; those of Magics from red to blue, and the mark means the header's colour.
        ([mark | first, pack(1, 1, 1), mark], b"", [[255, 132, 0, 255], DEFAULT, [0, 0, 0, 255]]),
        ([first, mark, last], magics, [[0, 132, 255, 255], own, [255, 0, 0, 255]]),
        ([0, 0, 0], magics, [own, own, own]),
    ):
        looks = load(make_stl(attributes, header)).appearance
        assert looks.colours.tolist() == [[colour] * 3 for colour in expected]
        assert looks.materials[0].base_colour == (1, 1, 1)
    for attributes in ([0, 0, 0], [1, 2, 0x7FFF]):
        assert load(make_stl(attributes)).appearance is None


def test_counts_comments_and_more_numbers_of_off_files(load):
    for head in ("OFF\n4 2 0\n", "OFF 4 2 0\n", "# by hand\nCOFF\n\n4 2 0 # counts\n", "OFF\r\n4 2\r\n"):
        text = head + "".join(f"{vertex} 255 0 0\n\n" for vertex in VERTICES)
        mesh = load(text + "4 0 1 2 3 0.5 0.5 0.5 # red\n3 2 1 0 0.5 0.5 0.5\n")
        assert mesh.faces.tolist() == CUT.tolist()
        assert mesh.vertices.tolist() == [[float(x) for x in vertex.split()] for vertex in VERTICES]


def test_all_that_stands_behind_coordinates_is_read(load):
    lines = [f"{one} 0 {i} 1 {60 * i} 0 255 {i} 0.25 {i}" for i, one in enumerate(VERTICES)]
    looks = load("STCNOFF\n4 2 0\n" + "\n".join(lines) + "\n" + FACES).appearance
    ids = np.arange(4)
    normals = np.column_stack((0 * ids, ids, 0 * ids + 1)) / np.hypot(ids, 1)[:, None]
    np.testing.assert_allclose(looks.normals, normals[CUT], atol=1e-6)
    np.testing.assert_array_equal(looks.colours, np.column_stack((60 * ids, 0 * ids, 0 * ids + 255, ids))[CUT])
    np.testing.assert_array_equal(looks.uvs, np.column_stack((0 * ids + 0.25, ids))[CUT])
    for colour, expected in (("1 0 1", [1, 0, 1, 255]), ("1.0 0.0 0.2", [255, 0, 51, 255])):
        vertices = "\n".join(f"{one} {colour}" for one in VERTICES)
        assert load(f"COFF\n4 2 0\n{vertices}\n{FACES}").appearance.colours.tolist() == [[expected] * 3] * 3
