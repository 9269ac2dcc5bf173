"""Corners of an STL file with two solids were merged when they were nearer than 1e-8, whatever the unit."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from clbvh import load_mesh

TRIANGLES = 1e-9 * np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]])


def make_text(triangles: np.ndarray) -> bytes:
    text = ""
    for triangle in triangles:
        corners = "".join(f"   vertex {x!r} {y!r} {z!r}\n" for x, y, z in triangle.tolist())
        text += f"solid part\n facet normal 0 0 1\n  outer loop\n{corners}  endloop\n endfacet\nendsolid part\n"
    return text.encode()


def make_binary(triangles: np.ndarray) -> bytes:
    rows = b"".join(struct.pack("<12fH", 0, 0, 1, *triangle.ravel(), 0) for triangle in triangles)
    return b"solid of two".ljust(80) + struct.pack("<I", len(triangles)) + rows


@pytest.mark.parametrize("make", [make_text, make_binary])
def test_only_equal_corners_are_merged(tmp_path, make):
    path = tmp_path / "a.stl"
    path.write_bytes(make(TRIANGLES))
    mesh = load_mesh(path)
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]
    assert len(mesh.vertices) == 4
    assert mesh.vertices[mesh.faces] == pytest.approx(TRIANGLES, rel=1e-6, abs=1e-16)
    # One unit in the last place is a difference.
    moved = TRIANGLES.astype(np.float32)
    moved[1, 0, 0] = np.nextafter(moved[1, 0, 0], np.float32(1))
    path.write_bytes(make(moved.astype(np.float64)))
    assert load_mesh(path).faces.tolist() == [[0, 1, 2], [3, 4, 2]]
