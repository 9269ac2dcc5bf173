"""Parts of meshes: from files, through copies, and in hits."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import clbvh
from clbvh import Material, Mesh, Part, Scene, Spheres, Tracer, Transform, load_mesh
from clbvh.errors import ConfigError, MeshError
from clbvh.geometry.spheres import with_material

from .gltf_files import Gltf

CORNERS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
FACES = [[0, 1, 2], [0, 2, 3], [0, 1, 3]]
PARTS = (Part("left", 0, 2), Part("right", 2, 3))
DOWN = [[0, 0, -1]]


def make_square(parts=PARTS):
    return Mesh.from_arrays(CORNERS, FACES, parts=parts)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ([("a", 1, 3)], r"the part 'a' has the faces 1 to 3, but the part before it ends at 0"),
        ([("a", 0, 2), ("b", 1, 3)], r"the part 'b' has the faces 1 to 3, but the part before it ends at 2"),
        ([("a", 0, 0), ("b", 0, 3)], r"the part 'a' has the faces 0 to 0"),
        ([("a", 0, 4)], r"the part 'a' has the faces 0 to 4, .* and the mesh has 3 faces"),
        ([("a", 0, 2)], r"the parts end at face 2, but the mesh has 3 faces"),
        ([("a", 0)], r"parts must be a sequence of clbvh\.Part"),
        ([("a", 0, 1.5)], r"parts must be a sequence of clbvh\.Part"),
        (5, r"parts must be a sequence of clbvh\.Part"),
    ],
)
def test_parts_cover_the_faces_one_after_the_other(parts, message):
    with pytest.raises(MeshError, match=message):
        make_square(parts)


@pytest.mark.parametrize(
    "change",
    [
        lambda mesh: mesh.with_vertices(mesh.vertices * 2),
        lambda mesh: with_material(mesh, Material("red")),
        lambda mesh: Transform(scale=2).apply(mesh),
        copy.deepcopy,
        lambda mesh: pickle.loads(pickle.dumps(mesh)),
    ],
    ids=["moved", "material", "transform", "copy", "pickle"],
)
def test_parts_stay_where_faces_stay(change):
    assert change(make_square()).parts == PARTS


def test_parts_are_saved(tmp_path):
    scene = Scene()
    scene.place(scene.add(make_square()))
    scene.place(scene.add(make_square(())))
    scene.save(tmp_path / "scene")
    assert [shape.parts for shape in Scene.load(tmp_path / "scene").snapshot().shapes] == [PARTS, ()]


VERTICES = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("f 1 2 3\nf 1 3 4", []),
        ("o one\nf 1 2 3", []),
        ("o one\nf 1 2 3\no none", []),
        ("o one\nf 1 2 3\no other\nf 1 2 3 4", [("one", 0, 1), ("other", 1, 3)]),
        ("f 1 2 3\ng  x   y \nf 1 2 3", [("file", 0, 1), ("x y", 1, 2)]),
        ("g x\nf 1 2 3\ng y\nf 1 2 3\ng x\nf 1 2 4", [("x", 0, 1), ("y", 1, 2), ("x", 2, 3)]),
        ("o one\ng x\nf 1 2 3\ng y\nf 1 2 3\no other\nf 1 2 3", [("one", 0, 2), ("other", 2, 3)]),
        ("o one\nf 1 2\nf 1 2 3\no line\nf 1 2\no other\nf 1 2 3", [("one", 0, 1), ("other", 1, 2)]),
    ],
    ids=["none", "one", "an empty one", "objects", "above the first", "again", "objects before groups", "no triangles"],
)
@pytest.mark.filterwarnings("ignore::clbvh.AppearanceWarning")
def test_objects_and_groups_of_obj_files(tmp_path, text, parts):
    (tmp_path / "file.obj").write_text(VERTICES + text + "\n")
    assert list(load_mesh(tmp_path / "file.obj").parts) == parts


def make_glb(path):
    """A mesh that is placed as it is, mirrored in a turned parent, and a line; and one without a name."""
    gltf = Gltf()
    corners = gltf.add_accessor(CORNERS, "f4")
    normals = gltf.add_accessor(np.tile([0.6, 0, 0.8], (4, 1)), "f4")
    indices = gltf.add_accessor(np.ravel(FACES[:2]), "u2")
    first = gltf.add_mesh({"attributes": {"POSITION": corners, "NORMAL": normals}, "indices": indices})
    line = gltf.add_mesh({"attributes": {"POSITION": corners}, "mode": 1})
    second = gltf.add_mesh({"attributes": {"POSITION": corners}, "indices": indices, "material": 0})
    gltf.document["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}]
    gltf.add_node(mesh=first, name="plain")
    gltf.add_node(mesh=line, name="line")
    inner = gltf.add_node(is_root=False, mesh=first, name="mirror", scale=[-2, 1, 1])
    gltf.add_node(children=[inner], translation=[0, 0, 5], rotation=[0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    gltf.add_node(mesh=second, translation=[3, 0, 0])
    return gltf.write_glb(path)


def test_nodes_of_gltf_files(tmp_path):
    mesh = load_mesh(make_glb(tmp_path / "file.glb"))
    assert mesh.parts == (Part("plain", 0, 2), Part("mirror", 2, 4), Part("file", 4, 6))
    plain, mirror, other = (mesh.vertices[mesh.faces[part.begin : part.end]] for part in mesh.parts)
    # Mirrored in x, and then turned by 90 degrees: (x, y) becomes (-y, -2x); the corners run backwards.
    expected = np.stack((-plain[..., 1], -2 * plain[..., 0], np.full((2, 3), 5)), axis=-1)[:, ::-1]
    assert mirror == pytest.approx(expected, abs=1e-12)
    assert other == pytest.approx(plain + np.array([3, 0, 0]))
    normals = mesh.appearance.normals
    assert normals[0, 0] == pytest.approx([0.6, 0, 0.8], abs=1e-6)
    turned = np.array([0, -0.3, 0.8]) / np.hypot(0.3, 0.8)
    assert normals[2:4] == pytest.approx(np.broadcast_to(turned, (2, 3, 3)), abs=1e-6)
    assert normals[4:] == pytest.approx(np.broadcast_to([0, 0, 1], (2, 3, 3)))
    assert [mesh.appearance.materials[number].base_colour for number in mesh.appearance.material_ids[[3, 4]]] == [
        Material().base_colour,
        (1, 0, 0),
    ]


def test_a_list_of_points_that_meshes_share_is_not_repeated(tmp_path):
    gltf = Gltf()
    points = gltf.add_accessor(np.arange(300).reshape(100, 3), "f4")
    for first in (0, 50):
        indices = gltf.add_accessor(first + np.arange(3), "u2")
        gltf.add_node(mesh=gltf.add_mesh({"attributes": {"POSITION": points}, "indices": indices}))
    mesh = load_mesh(gltf.write_glb(tmp_path / "file.glb"))
    assert len(mesh.vertices) == 6
    assert mesh.vertices[mesh.faces[1, 0]].tolist() == [150, 151, 152]


def test_hits_on_a_mesh_name_its_parts():
    with Tracer(make_square()) as tracer:
        hits = tracer.closest_hit([[[0.9, 0.8, 1], [0.5, 0.9, 1]], [[0.1, 0.2, 1], [5, 0, 1]]], DOWN)
        alone = tracer.closest_hit([0.1, 0.2, 1], [0, 0, -1])
    assert hits.prim_id.tolist() == [[0, 1], [1, -1]]
    assert hits.part_id.tolist() == [[0, 0], [0, -1]]
    assert (hits.part_id.dtype, alone.part_id.shape) == (np.int32, ())
    with Tracer(make_square((("each", 0, 1), ("other", 1, 3)))) as tracer:
        assert tracer.all_hits([[0.5, 0.25, 1], [0.25, 0.5, 1]], DOWN).part_id.tolist() == [0, 1, 1, 1]


def test_hits_in_a_scene_name_the_parts_of_their_mesh():
    scene = Scene()
    shapes = [make_square(()), make_square(), Spheres([[0.25, 0.6, 0]], 0.1), make_square([("whole", 0, 3)])]
    geometries = [scene.add(shape) for shape in shapes]
    for number, geometry in enumerate([*geometries, geometries[1]]):
        scene.place(geometry, Transform(translate=(3 * number, 0, 0)))
    with Tracer(scene) as tracer:
        hits = tracer.closest_hit([[3 * number + 0.25, 0.6, 5] for number in range(6)], DOWN)
    assert hits.instance_id.tolist() == [0, 1, 2, 3, 4, -1]
    assert hits.part_id.tolist() == [-1, 0, -1, 0, 0, -1]
    assert hits[1:3].part_id.tolist() == [0, -1]


def test_hits_without_their_mesh_know_no_parts():
    with pytest.raises(ConfigError, match="do not know their mesh"):
        clbvh.Hits(*np.zeros((3, 1)), np.zeros(1, np.int32)).part_id  # noqa: B018


def make_obj(path):
    """Ten knots, each a group, side by side."""
    lines, first = [], 1
    for number in range(10):
        knot = clbvh.make_shape("knot", triangles=300)
        lines.append(f"g knot {number}")
        lines += [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in knot.vertices + np.array([2.5 * number, 0, 0])]
        lines += [f"f {a} {b} {c}" for a, b, c in knot.faces + first]
        first += len(knot.vertices)
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("make", [make_obj, make_glb], ids=["obj", "glb"])
def test_parts_are_hit_as_the_geometries_that_add_parts_makes(tmp_path, make):
    """Rays that pass an edge closer than float32 tells may see either side."""
    path = make(tmp_path / f"file.{make.__name__[-3:]}")
    scene = Scene()
    instances = scene.add_parts(path)
    mesh = load_mesh(path)
    generator = np.random.default_rng(4)
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    targets = generator.uniform(lower, upper, (4000, 3))
    origins = targets + generator.normal(size=(4000, 3)) * (upper - lower).max()
    with Tracer(mesh) as together, Tracer(scene) as apart:
        one, other = (tracer.closest_hit(origins, targets - origins) for tracer in (together, apart))
    same = (one.part_id == other.instance_id) & np.isclose(one.t, other.t, rtol=1e-9)
    assert same[~one.is_hit | ~other.is_hit].mean() > 0.99
    assert same.mean() > 0.999
    assert set(one.part_id.tolist()) == {-1, *range(len(mesh.parts))}
    assert [part.name for part in mesh.parts] == [instance.name for instance in instances]
    np.testing.assert_allclose(one.locations[same], other.locations[same], atol=1e-9)
    np.testing.assert_allclose(one.normals[same], other.normals[same], atol=1e-9)
