"""Any file gives a mesh or a `MeshError`; any convex polygon is covered exactly once."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from clbvh import load_mesh
from clbvh.errors import MeshError
from clbvh.geometry.loading.polygons import cut_fans
from clbvh.geometry.shapes.make_shape import make_shape

from ..profiles import examples

SPHERE = make_shape("icosphere", triangles=20)
SOURCE = trimesh.Trimesh(SPHERE.vertices, SPHERE.faces, process=False)
FILES = {
    "ply": SOURCE.export(file_type="ply"),
    "ascii.ply": SOURCE.export(file_type="ply", encoding="ascii").replace(b"\n\n", b"\n"),
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
@examples(short=100, long=2000, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(cuts=st.lists(CUTS, min_size=1, max_size=3))
def test_a_damaged_file_is_a_mesh_or_a_mesh_error(tmp_path, file_type, cuts):
    content = FILES[file_type]
    for share, length, piece in cuts:
        at = int(share * len(content))
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


@given(sizes=st.lists(st.integers(3, 12), min_size=1, max_size=6))
def test_a_fan_covers_a_convex_polygon_exactly_once(sizes):
    rings = [np.arange(size) * (2 * np.pi / size) for size in sizes]
    angles = np.concatenate(rings)
    x, y = np.cos(angles), np.sin(angles)
    faces = cut_fans(np.arange(len(angles)), np.array(sizes))
    assert len(faces) == sum(sizes) - 2 * len(sizes)

    (ax, bx, cx), (ay, by, cy) = x[faces].T, y[faces].T
    areas = ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)) / 2
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(sum(size * np.sin(2 * np.pi / size) / 2 for size in sizes))
