from pathlib import Path

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.geometry.as_mesh import as_mesh

CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
FACES = np.array([[0, 1, 2]])
MESH = clbvh.Mesh.from_arrays(CORNERS, FACES)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "triangle.off"
    path.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    return path


def forms(file):
    return {
        "a mesh": MESH,
        "a trimesh": trimesh.Trimesh(CORNERS, FACES),
        "a path": file,
        "a name of a file": str(file),
        "a tuple": (CORNERS, FACES),
        "a list": [CORNERS.tolist(), FACES.tolist()],
    }


@pytest.mark.parametrize("form", forms(Path()))
def test_every_form_is_the_same_mesh(form, file):
    mesh = as_mesh(forms(file)[form])
    assert mesh.fingerprint == MESH.fingerprint
    np.testing.assert_array_equal(mesh.vertices, CORNERS)


@pytest.mark.parametrize("form", forms(Path()))
def test_every_form_can_be_built_and_traced(form, file):
    thing = forms(file)[form]
    assert clbvh.build(thing).nodes.tobytes() == clbvh.build(MESH).nodes.tobytes()
    with clbvh.Tracer(thing) as tracer:
        assert tracer.closest_hit([[0.25, 0.25, 2]], [[0, 0, -1]]).t == 2


def test_a_mesh_is_not_copied():
    assert as_mesh(MESH) is MESH


def test_arrays_are_copied():
    corners = CORNERS.copy()
    mesh = as_mesh((corners, FACES))
    corners[:] = 7
    np.testing.assert_array_equal(mesh.vertices, CORNERS)


@pytest.mark.parametrize(
    ("thing", "described"),
    [
        (5, "int 5"),
        (None, "NoneType None"),
        (b"bunny.ply", "bytes b'bunny.ply'"),
        (CORNERS, "a numpy.ndarray"),
        ((CORNERS,), "a tuple"),
        ((CORNERS, FACES, FACES), "a tuple"),
        ({"vertices": 1}, "dict {'vertices': 1}"),
        (trimesh.Scene(), "a trimesh.Scene"),
        (trimesh.PointCloud(CORNERS), "a trimesh.PointCloud"),
    ],
)
def test_anything_else_is_one_sentence_with_the_accepted_forms(thing, described):
    with pytest.raises(clbvh.MeshError) as raised:
        as_mesh(thing)
    message = str(raised.value)
    assert described in message
    assert all(form in message for form in ("clbvh.Mesh", "trimesh.Trimesh", "path", "(vertices, faces)"))
    assert "\n" not in message


def test_a_tracer_also_names_a_tree():
    with pytest.raises(clbvh.MeshError, match=r"clbvh\.Bvh, a clbvh\.Mesh"):
        clbvh.Tracer(7)


def test_invalid_arrays_are_refused_as_in_from_arrays():
    with pytest.raises(clbvh.MeshError, match="refers to vertex 3"):
        clbvh.build((CORNERS, [[0, 1, 3]]))


@pytest.mark.parametrize("thing", [trimesh.Trimesh, trimesh.primitives.Box, clbvh.Mesh])
def test_a_class_is_no_mesh(thing):
    with pytest.raises(clbvh.MeshError, match=r"expected a clbvh.Mesh.*not "):
        as_mesh(thing)


class NoArray:
    def __array__(self, *args, **how):
        raise TypeError("no numbers here")


@pytest.mark.parametrize("pair", [(NoArray(), FACES), (CORNERS, NoArray())])
def test_objects_that_are_no_arrays(pair):
    with pytest.raises(clbvh.MeshError, match="no numbers here"):
        as_mesh(pair)


def test_masked_values_are_no_numbers():
    masked = np.ma.masked_array(CORNERS, mask=np.eye(3))
    for pair in ((masked, FACES), (CORNERS, np.ma.masked_equal(FACES, 2))):
        with pytest.raises(clbvh.MeshError, match="some are masked"):
            as_mesh(pair)
    with pytest.raises(clbvh.MeshError, match="some are masked"):
        MESH.with_vertices(masked)
    assert as_mesh((np.ma.masked_array(CORNERS), FACES)).fingerprint == MESH.fingerprint


def test_more_vertices_than_the_memory_holds():
    with pytest.raises(clbvh.MeshError, match=r"a mesh of 1,099,511,627,776 vertices needs about .* MB are free"):
        as_mesh((np.broadcast_to(CORNERS[:1], (2**40, 3)), FACES))
