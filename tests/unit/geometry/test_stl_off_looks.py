"""Colours in STL files, of both kinds, and looks in OFF files."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.geometry.appearance.srgb import linear_to_srgb

TRIANGLES = np.float32(
    [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]]
)
DEFAULT = [*np.rint(linear_to_srgb(clbvh.Material().base_colour) * 255).astype(int), 255]


def write_stl(path, attributes, header=b""):
    rows = np.zeros(len(TRIANGLES), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows["corners"], rows["attribute"] = TRIANGLES, attributes
    path.write_bytes(header.ljust(80, b"\0") + len(rows).to_bytes(4, "little") + rows.tobytes())
    return path


def pack(first, second, third):
    return first | second << 5 | third << 10


def test_marked_colours_run_from_blue_to_red(tmp_path):
    attributes = [0x8000 | pack(0, 16, 31), pack(1, 1, 1), 0x8000]
    looks = clbvh.load_mesh(write_stl(tmp_path / "a.stl", attributes)).appearance
    for corner in range(3):
        np.testing.assert_array_equal(looks.colours[:, corner], [[255, 132, 0, 255], DEFAULT, [0, 0, 0, 255]])
    assert looks.materials[0].base_colour == (1, 1, 1)


def test_colours_of_magics_run_from_red_to_blue_and_have_a_default(tmp_path):
    header = b"by hand COLOR=" + bytes([9, 8, 7, 200]) + b",MATERIAL="
    looks = clbvh.load_mesh(write_stl(tmp_path / "a.stl", [pack(0, 16, 31), 0x8000, pack(31, 0, 0)], header)).appearance
    np.testing.assert_array_equal(looks.colours[:, 0], [[0, 132, 255, 255], [9, 8, 7, 200], [255, 0, 0, 255]])
    all_default = clbvh.load_mesh(write_stl(tmp_path / "b.stl", [0, 0, 0], header)).appearance
    np.testing.assert_array_equal(all_default.colours[:, 0], [[9, 8, 7, 200]] * 3)


@pytest.mark.parametrize("attributes", [[0, 0, 0], [1, 2, 0x7FFF]])
def test_attributes_without_a_mark_are_no_colours(tmp_path, attributes):
    assert clbvh.load_mesh(write_stl(tmp_path / "a.stl", attributes)).appearance is None


def load(path, text):
    path.write_text(text)
    return clbvh.load_mesh(path)


VERTICES = ["0 0 0", "2 0 0", "2 1 0", "0 1 0"]
FACES = "4 0 1 2 3\n3 2 1 0\n"
CUT = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0]])


def test_all_that_stands_behind_coordinates_is_read(tmp_path):
    lines = [f"{one} 0 {i} 1 {60 * i} 0 255 {i} 0.25 {i}" for i, one in enumerate(VERTICES)]
    looks = load(tmp_path / "a.off", "STCNOFF\n4 2 0\n" + "\n".join(lines) + "\n" + FACES).appearance
    ids = np.arange(4)
    normals = np.column_stack((0 * ids, ids, 0 * ids + 1)) / np.hypot(ids, 1)[:, None]
    np.testing.assert_allclose(looks.normals, normals[CUT], atol=1e-6)
    np.testing.assert_array_equal(looks.colours, np.column_stack((60 * ids, 0 * ids, 0 * ids + 255, ids))[CUT])
    np.testing.assert_array_equal(looks.uvs, np.column_stack((0 * ids + 0.25, ids))[CUT])


@pytest.mark.parametrize(("colour", "expected"), [("1 0 1", [1, 0, 1, 255]), ("1.0 0.0 0.2", [255, 0, 51, 255])])
def test_whole_numbers_are_bytes_and_others_shares(tmp_path, colour, expected):
    vertices = "\n".join(f"{one} {colour}" for one in VERTICES)
    looks = load(tmp_path / "a.off", f"COFF\n4 2 0\n{vertices}\n{FACES}").appearance
    assert looks.colours.tolist() == [[expected] * 3] * 3


def test_colours_of_faces_follow_the_cut(tmp_path):
    text = "OFF\n4 2 0\n" + "\n".join(VERTICES) + "\n4 0 1 2 3 255 0 7\n3 2 1 0 1 2 3\n"
    looks = load(tmp_path / "a.off", text).appearance
    assert looks.colours[:, 0].tolist() == [[255, 0, 7, 255], [255, 0, 7, 255], [1, 2, 3, 255]]
    text = text.replace("4 2 0", "4 1 0").replace("\n3 2 1 0 1 2 3", "")
    assert load(tmp_path / "a.off", text).appearance.colours[:, 2].tolist() == [[255, 0, 7, 255]] * 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("COFF\n4 2 0\n0 0 0 1 1 1\n1 0 0\n2 1 0\n0 1 0\n", "vertices cannot be used: their numbers are not"),
        ("COFF\n4 2 0\n0 0 0 1\n1 0 0 1\n2 1 0 1\n0 1 0 1\n", "their numbers are not those that the keyword announces"),
        ("OFF\n4 3 0\n0 0 0\n1 0 0\n2 1 0\n0 1 0\n3 0 1 2 9 9 9\n", "colours cannot be used: not all faces"),
    ],
)
def test_what_cannot_be_used_is_one_warning(tmp_path, text, message):
    with pytest.warns(clbvh.AppearanceWarning, match=message):
        mesh = load(tmp_path / "a.off", text + FACES)
    assert mesh.faces[-3:].tolist() == CUT.tolist()
    assert mesh.appearance is None


def test_an_index_of_a_colour_is_ignored(tmp_path):
    text = "OFF\n4 1 0\n" + "\n".join(VERTICES) + "\n4 0 1 2 3 7\n"
    assert load(tmp_path / "a.off", text).appearance is None
