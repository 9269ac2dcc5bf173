"""Scenes of several parts, each a geometry of its own: of GLB, glTF and OBJ files, of trimesh, and of clbvh itself."""

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import MeshError, SceneError

from ..geometry.gltf_files import Gltf
from .test_scene import names, shifted

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
VERTICES = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 9 9 9\n"


def flatten(scene):
    """Return the corners of all triangles, (n, 3, 3), in the order of the instances; fronts stay fronts."""
    corners = [np.empty((0, 3, 3))]
    for instance in scene.instances:
        mesh, matrix = instance.geometry.shape, instance.transform
        moved = (mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3])[mesh.faces]
        corners.append(moved[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else moved)
    return np.concatenate(corners)


def parts_of(source, *arguments, **options):
    scene = clbvh.Scene()
    assert scene.add_parts(source, *arguments, **options) == scene.instances
    return scene


@pytest.fixture
def house(tmp_path):
    """Two meshes, of which the first is placed three times, within a tree of nodes; and lines."""
    gltf = Gltf()
    first = gltf.add_accessor(SQUARE, "f4")
    second = gltf.add_accessor(SQUARE[:3] + np.array([0, 0, 5]), "f4")
    quad = {"attributes": {"POSITION": first}, "mode": 6}
    wall, roof = gltf.add_mesh(quad), gltf.add_mesh({"attributes": {"POSITION": second}}, quad)
    lines = gltf.add_mesh({"attributes": {"POSITION": first}, "mode": 1})
    gltf.document["meshes"][wall]["name"] = "wall"
    inner = gltf.add_node(is_root=False, mesh=wall, name="inner", translation=[0, 0, 2])
    gltf.add_node(name="house", scale=[2, 2, 2], children=[inner])
    gltf.add_node(mesh=roof)
    gltf.add_node(mesh=lines, name="lines")
    gltf.add_node(mesh=wall, name="mirrored", scale=[-1, 1, 1])
    gltf.add_node(mesh=wall, name="inner")
    return gltf.write_glb(tmp_path / "house.glb")


def test_meshes_that_nodes_share_are_one_geometry(house):
    scene = parts_of(house)
    assert names(scene.geometries) == ["wall", "house"]
    assert [geometry.shape.name for geometry in scene.geometries] == ["wall.glb", "house.glb"]
    assert names(scene.instances) == ["inner", "house", "mirrored", "inner 2"]
    assert [instance.geometry.id for instance in scene.instances] == [0, 1, 0, 0]
    assert scene.instances[0].transform.tolist() == [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 4], [0, 0, 0, 1]]
    whole = clbvh.load_mesh(house)
    assert flatten(scene).tolist() == whole.vertices[whole.faces].tolist()
    added = clbvh.Scene().add(house)
    assert (added.name, added.shape.face_count) == ("house", 9)


def test_the_whole_is_moved_and_masked(house):
    for mask in (6, 0):
        moved = parts_of(house, clbvh.Transform(scale=2, translate=(1, 2, 3)), mask=mask)
        assert flatten(moved) == pytest.approx(flatten(parts_of(house)) * 2 + [1, 2, 3])
        assert {instance.mask for instance in moved.instances} == {mask}


@pytest.mark.parametrize("seed", range(3))
def test_random_gltf_files_have_the_triangles_of_the_flattened_ones(tmp_path, seed):
    rng = np.random.default_rng(seed)
    gltf = Gltf()
    points = [gltf.add_accessor(rng.normal(size=(rng.integers(3, 9), 3)), "f4") for _ in range(3)]
    for _ in range(4):
        gltf.add_mesh(*({"attributes": {"POSITION": int(rng.choice(points))}, "mode": 6} for _ in range(2)))
    for number in range(9):
        keys = {"translation": rng.normal(size=3).tolist(), "scale": rng.normal(size=3).tolist()}
        if number % 3:
            keys["mesh"] = int(rng.integers(4))
        keys["children"] = [number + 1] if number % 2 else []
        gltf.add_node(is_root=number % 2 == 1 or number == 0, name=f"node {number}", **keys)
    path = gltf.write_glb(tmp_path / "a.glb")
    whole = clbvh.load_mesh(path)
    assert flatten(parts_of(path)) == pytest.approx(whole.vertices[whole.faces], abs=1e-12)


def test_objects_or_else_groups_of_obj_files_are_parts(tmp_path):
    path = tmp_path / "a.obj"
    for text, expected in (
        (
            "f 1 2 3\no left \ng ignored\nf 1 2 3\nf 1 3 4\no right\nv 7 7 7\nf -1 1 2 3 \n",
            {"a": (3, 1), "left": (4, 2), "right": (4, 2)},
        ),
        ("g a b\nf 1 2 3\ng c\nf 1 3 4\ng a  b\nf 2 3 4\ng\nf 4 3 2\n", {"a": (3, 1), "a b": (4, 2), "c": (3, 1)}),
        ("f 1 2 3 4\n", {"a": (4, 2)}),  # one vertex is loose
    ):
        path.write_text(VERTICES + text)
        scene, whole = parts_of(path), clbvh.load_mesh(path)
        sizes = {each.name: (len(each.shape.vertices), each.shape.face_count) for each in scene.geometries}
        assert sizes == expected
        assert names(scene.instances) == list(expected)
        assert len(flatten(scene)) == whole.face_count


@pytest.fixture
def cart():
    """A scene of trimesh: a box placed twice, points, and a ball."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), node_name="body", geom_name="box", transform=shifted(1, 0, 0))
    scene.graph.update("wheel a", geometry="box", matrix=np.diag([-2.0, 1, 1, 1]), frame_from="body")
    scene.add_geometry(trimesh.PointCloud([[0, 0, 0]]), node_name="dots")
    scene.add_geometry(trimesh.creation.icosphere(), node_name="ball", geom_name="ball")
    return scene


def test_the_graph_of_trimesh_and_its_names_are_kept(cart):
    scene = parts_of(cart)
    assert set(names(scene.instances)) == {"body", "wheel a", "ball"}
    assert names(scene.geometries) == ["box", "ball"]
    assert scene.find("wheel a").geometry is scene.find("body").geometry
    for instance in scene.instances:
        matrix, name = cart.graph[instance.name]
        assert instance.geometry.name == name
        assert (instance.transform == matrix).all()


def test_a_scene_of_trimesh_is_added_as_one_mesh_with_parts(cart):
    parts, whole = parts_of(cart), clbvh.Scene()
    added = whole.add(cart, name="cart")
    whole.place(added)
    assert flatten(whole) == pytest.approx(flatten(parts), abs=1e-15)
    assert names(added.shape.parts) == names(parts.instances)
    assert [part.end - part.begin for part in added.shape.parts] == [12, 12, 1280]
    box = clbvh.Scene().add(trimesh.Scene(trimesh.creation.box()))
    assert (box.shape.face_count, box.shape.parts) == (12, ())


def test_a_scene_of_trimesh_is_traced_built_and_drawn(cart):
    origins = [[1, 0, 5], [1, 0.1, 5], [9, 9, 5]]
    with clbvh.Tracer(cart) as tracer, clbvh.Tracer(clbvh.Scene(cart)) as expected:
        hits, wanted = (each.closest_hit(origins, [0, 0, -1]) for each in (tracer, expected))
        assert hits.t.tolist() == wanted.t.tolist() == [4.5, 4.5, np.inf]
        assert hits.part_id.tolist() == wanted.part_id.tolist()
    assert clbvh.build(cart).mesh.parts == clbvh.Scene(cart).geometries[0].shape.parts
    for number in range(4):
        cart.graph.update(f"ball {number}", geometry="ball", matrix=shifted(0, number, 0))
    with clbvh.Tracer(cart) as tracer, clbvh.Renderer(cart) as renderer:
        assert tracer.closest_hit([0, 3.5, 5], [0, 0, -1]).instance_id > 2
        assert names(renderer.scene.instances)[-1] == "ball 3"
    cart.graph.update("bent", geometry="ball", matrix=np.vstack([np.eye(4)[:3], [0, 0, 0.5, 1]]))
    with pytest.raises(MeshError, match=r"the transform of 'bent' must be .* last row 0, 0, 0, 1"):
        clbvh.build(cart)


def test_the_last_row_of_a_node_may_be_rounded():
    source = trimesh.Scene()
    matrix = np.diag([2, 2, 2, 1 + 1e-9])
    source.add_geometry(trimesh.creation.box(), node_name="box", transform=matrix)
    assert parts_of(source).instances[0].transform.tolist() == np.diag([2.0, 2, 2, 1]).tolist()


def test_a_scene_goes_into_another_one():
    inner = clbvh.Scene()
    inner.place(inner.add(clbvh.make_shape("icosphere", triangles=80)), clbvh.Transform(scale=2), colour=(1, 0, 0))
    inner.place(inner.add(clbvh.Spheres([[0, 0, 0]], 1, name="dot")), mask=3, material=clbvh.Material("gold"))
    outer = clbvh.Scene()
    outer.add_parts(inner, shifted(5, 0, 0))
    outer.add_parts(inner)
    assert names(outer.geometries) == names(outer.instances) == ["icosphere", "dot", "icosphere 2", "dot 2"]
    assert [each.mask for each in outer.instances] == [2**32 - 1, 3] * 2
    assert [each.colour for each in outer.instances] == [(1, 0, 0), None] * 2
    assert [each.material for each in outer.instances] == [None, clbvh.Material("gold")] * 2
    assert outer.instances[0].transform.tolist() == (shifted(5, 0, 0) @ np.diag([2.0, 2, 2, 1])).tolist()
    assert outer.geometries[1].shape is inner.geometries[1].shape
    inner.add_parts(inner)
    assert len(inner.instances) == 4


def test_what_cannot_be_added_adds_nothing(tmp_path):
    (tmp_path / "b.obj").write_text(VERTICES + "o a\nf 1 2 3\no b\nf 1 2 9\n")
    torn = trimesh.Scene()
    triangle = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], process=False)
    torn.add_geometry(triangle, geom_name="torn")
    ball = clbvh.make_shape("icosphere", triangles=80)
    inner, far, scene = clbvh.Scene(ball), clbvh.Scene(), clbvh.Scene()
    far.place(far.add(ball), clbvh.Transform(scale=1e200))
    for error, source, arguments, message in (
        (MeshError, tmp_path / "b.obj", {}, "face 1 refers to vertex 9, but there are 5"),
        (SceneError, trimesh.Scene(trimesh.PointCloud([[0, 0, 0]])), {}, "no node with a triangle mesh"),
        (MeshError, torn, {}, "torn: vertex 2"),
        (SceneError, trimesh.creation.box(), {}, r"expected the path of a file, a trimesh\.Scene or a clbvh\.Scene"),
        (SceneError, inner, {"transform": np.diag([0, 0, 0, 1])}, "the transform is singular"),
        (SceneError, far, {"transform": np.diag([1e200] * 3 + [1])}, "transform of 'icosphere' must be finite"),
    ):
        with pytest.raises(error, match=message):
            scene.add_parts(source, **arguments)
    assert scene.geometries == ()
