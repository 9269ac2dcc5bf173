"""Whatever stands in a file: a mesh or a `MeshError`. Whatever a number looks like: the double that `float` gives."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clbvh import load_mesh
from clbvh.errors import MeshError
from clbvh.geometry.polygons import cut_polygons
from clbvh.geometry.shapes import make_shape
from clbvh.geometry.text_numbers import NotANumberError, count_tokens_per_line, parse_numbers

SPHERE = make_shape("icosphere", triangles=20)
SOURCE = trimesh.Trimesh(SPHERE.vertices, SPHERE.faces, process=False)
FILES = {
    "ply": SOURCE.export(file_type="ply"),
    "ascii.ply": SOURCE.export(file_type="ply", encoding="ascii"),
    "obj": SOURCE.export(file_type="obj").encode(),
    "off": SOURCE.export(file_type="off").encode(),
    "stl": SOURCE.export(file_type="stl"),
    "ascii.stl": SOURCE.export(file_type="stl_ascii").encode(),
    "glb": SOURCE.export(file_type="glb"),
}
PIECES = st.one_of(
    st.binary(max_size=6),
    st.sampled_from(["-1", "nan", "inf", "1e999", "99999999999", "0.5", "\n", " ", "v", "f", "property", "{", "}"]).map(
        str.encode
    ),
)
CUTS = st.tuples(st.floats(0, 1), st.integers(0, 12), PIECES)


@pytest.mark.parametrize("file_type", FILES)
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cuts=st.lists(CUTS, min_size=1, max_size=3))
def test_a_damaged_file_is_a_mesh_or_a_mesh_error(tmp_path, file_type, cuts):
    content = FILES[file_type]
    for place, length, piece in cuts:
        at = int(place * len(content))
        content = content[:at] + piece + content[at + length :]
    path = tmp_path / f"a.{file_type}"
    path.write_bytes(content)
    try:
        mesh = load_mesh(path)
    except MeshError as error:
        assert "\n" not in str(error)  # noqa: PT017 - that no other exception comes is the test
    else:
        assert np.isfinite(mesh.vertices).all()
        assert mesh.faces.min() >= 0
        assert mesh.faces.max() < len(mesh.vertices)


NUMBERS = st.one_of(
    st.floats().map(repr),
    st.floats(allow_nan=False, allow_infinity=False).map(lambda x: f"{x:.6e}"),
    st.floats(-1e6, 1e6).map(lambda x: f"{x:.8f}"),
    st.integers().map(str),
    st.from_regex(r"[-+]?[0-9]{1,25}(\.[0-9]{0,25})?([eE][-+]?[0-9]{1,4})?", fullmatch=True),
).filter(str.isascii)


@given(tokens=st.lists(NUMBERS, max_size=30))
def test_a_text_of_numbers_is_read_like_float_does(tokens):
    text = "\n".join(tokens).encode()
    assert parse_numbers(text).tobytes() == np.array([float(token) for token in tokens]).tobytes()


@given(text=st.binary(max_size=60))
def test_any_bytes_are_numbers_for_us_just_when_they_are_for_float(text):
    tokens = bytes(byte if byte > 32 else 32 for byte in text).split()
    try:
        expected = [float(token.decode("ascii")) for token in tokens if b"_" not in token]
        is_text = len(expected) == len(tokens)
    except ValueError:
        is_text = False
    if is_text:
        assert parse_numbers(text).tobytes() == np.array(expected, dtype=np.float64).tobytes()
    else:
        with pytest.raises(NotANumberError):
            parse_numbers(text)


@given(lines=st.lists(st.text(alphabet="1 \t\r", max_size=12), max_size=12))
def test_tokens_are_counted_as_split_does(lines):
    text = "".join(f"{line}\n" for line in lines).encode()
    assert count_tokens_per_line(text).tolist() == [len(line.split()) for line in lines]


@given(
    radii=st.lists(st.integers(1, 8), min_size=3, max_size=14),
    others=st.lists(st.integers(3, 6), max_size=3),
)
def test_a_star_shaped_polygon_is_covered_exactly_once(radii, others):
    angles = np.arange(len(radii)) * (2 * np.pi / len(radii))
    x, y = np.array(radii) * np.cos(angles), np.array(radii) * np.sin(angles)
    vertices = np.column_stack((x, y, np.zeros(len(radii))))
    fillers = [np.arange(size) % len(radii) for size in others]
    corners = np.concatenate([np.arange(len(radii)), *fillers])
    faces = cut_polygons(vertices, corners, np.array([len(radii), *others]), source="x")
    assert len(faces) == len(radii) - 2 + sum(size - 2 for size in others)

    a, b, c = (vertices[faces[: len(radii) - 2, corner], :2] for corner in range(3))
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    areas = (ux * vy - uy * vx) / 2
    shoelace = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    assert areas.min() > -1e-9
    assert areas.sum() == pytest.approx(shoelace)
