"""Scenes of several parts: of GLB, glTF and OBJ files, of trimesh, and of clbvh itself."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.errors import MeshError, SceneError

from ..geometry.gltf_files import Gltf

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
TWO_FACES = [[0, 1, 2], [0, 2, 3]]
OBJ = """
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 9 9 9
"""


def shifted(*translation):
    return clbvh.Transform(translate=translation).matrix


def flatten(scene):
    """Return the corners of all triangles, (n, 3, 3), in the order of the instances."""
    corners = [np.empty((0, 3, 3))]
    for instance in scene.instances:
        mesh, matrix = instance.geometry.shape, instance.transform
        moved = (mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3])[mesh.faces]
        # As the reader of flattened files does, so that the front stays in front.
        corners.append(moved[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else moved)
    return np.concatenate(corners)


def names(things):
    return [thing.name for thing in things]


class TestGltf:
    def make(self, tmp_path):
        """Two meshes, of which the first is placed three times, within a tree of nodes."""
        gltf = Gltf()
        first = gltf.add_accessor(SQUARE, "f4")
        second = gltf.add_accessor(SQUARE[:3] + np.array([0, 0, 5]), "f4")
        indices = gltf.add_accessor(np.ravel(TWO_FACES), "u2")
        wall = gltf.add_mesh({"attributes": {"POSITION": first}, "indices": indices})
        roof = gltf.add_mesh(
            {"attributes": {"POSITION": second}}, {"attributes": {"POSITION": first}, "indices": indices}
        )
        gltf.document["meshes"][wall]["name"] = "wall"
        inner = gltf.add_node(is_root=False, mesh=wall, name="inner", translation=[0, 0, 2])
        gltf.add_node(name="house", scale=[2, 2, 2], children=[inner])
        gltf.add_node(mesh=roof)
        gltf.add_node(mesh=wall, name="mirrored", scale=[-1, 1, 1])
        gltf.add_node(mesh=wall, name="inner")
        return gltf.write_glb(tmp_path / "house.glb")

    def test_shared_meshes_are_one_geometry(self, tmp_path):
        path = self.make(tmp_path)
        scene = clbvh.Scene()
        placed = scene.add_parts(path)
        assert placed == scene.instances
        assert names(scene.geometries) == ["wall", "house"]
        assert names(placed) == ["inner", "house", "mirrored", "inner 2"]
        assert [instance.geometry.id for instance in placed] == [0, 1, 0, 0]
        assert placed[0].transform.tolist() == [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 4], [0, 0, 0, 1]]
        assert scene.geometries[0].shape.name == "wall.glb"
        assert scene.geometries[1].shape.face_count == 3

    def test_the_parts_are_those_of_the_flattened_file(self, tmp_path):
        path = self.make(tmp_path)
        scene = clbvh.Scene()
        scene.add_parts(path)
        whole = clbvh.load_mesh(path)
        assert flatten(scene).tolist() == whole.vertices[whole.faces].tolist()

    def test_a_path_that_is_added_is_one_geometry(self, tmp_path):
        path = self.make(tmp_path)
        scene = clbvh.Scene()
        house = scene.add(path)
        assert house.name == "house"
        assert house.shape.face_count == clbvh.load_mesh(path).face_count == 9
        assert scene.instances == ()

    def test_parts_without_triangles_are_left_out(self, tmp_path):
        gltf = Gltf()
        points = gltf.add_accessor(SQUARE, "f4")
        lines = gltf.add_mesh({"attributes": {"POSITION": points}, "mode": 1})
        face = gltf.add_mesh({"attributes": {"POSITION": points}, "mode": 6})
        gltf.add_node(mesh=lines, name="lines")
        gltf.add_node(mesh=face, name="face")
        scene = clbvh.Scene()
        scene.add_parts(gltf.write_gltf(tmp_path / "a.gltf"))
        assert names(scene.instances) == ["face"]
        assert scene.geometries[0].shape.face_count == 2
        gltf.document["nodes"].pop()
        gltf.document["scenes"][0]["nodes"].pop()
        with pytest.raises(MeshError, match=r"a\.gltf: the file has no triangles"):
            scene.add_parts(gltf.write_gltf(tmp_path / "a.gltf"))

    def test_a_shared_list_of_points_is_not_repeated(self, tmp_path):
        gltf = Gltf()
        points = gltf.add_accessor(np.arange(300).reshape(100, 3), "f4")
        for corner in (0, 50):
            indices = gltf.add_accessor(corner + np.arange(3), "u2")
            gltf.add_node(mesh=gltf.add_mesh({"attributes": {"POSITION": points}, "indices": indices}))
        scene = clbvh.Scene()
        scene.add_parts(gltf.write_glb(tmp_path / "a.glb"))
        assert [len(geometry.shape.vertices) for geometry in scene.geometries] == [3, 3]
        assert scene.geometries[1].shape.vertices[0].tolist() == [150, 151, 152]
        assert names(scene.geometries) == ["a", "a 2"]

    def test_a_node_that_is_scaled_to_nothing_is_named(self, tmp_path):
        gltf = Gltf()
        gltf.add_node(
            mesh=gltf.add_mesh({"attributes": {"POSITION": gltf.add_accessor(SQUARE[:3], "f4")}}),
            name="hidden",
            scale=[0, 0, 0],
        )
        scene = clbvh.Scene()
        with pytest.raises(SceneError, match="the transform of 'hidden' is singular"):
            scene.add_parts(gltf.write_glb(tmp_path / "a.glb"))
        assert scene.geometries == ()

    def test_names_may_be_anything(self, tmp_path):
        gltf = Gltf()
        face = {"attributes": {"POSITION": gltf.add_accessor(SQUARE[:3], "f4")}}
        for name in (5, "", "  ", None, "\ud800"):
            mesh = gltf.add_mesh(face)
            gltf.document["meshes"][mesh]["name"] = name
            gltf.add_node(mesh=mesh, name=name)
        scene = clbvh.Scene()
        scene.add_parts(gltf.write_glb(tmp_path / "a.glb"))
        assert names(scene.instances) == names(scene.geometries) == ["a", "a 2", "a 3", "a 4", "?"]


class TestObj:
    def load(self, tmp_path, text):
        (tmp_path / "a.obj").write_text(OBJ + text)
        scene = clbvh.Scene()
        scene.add_parts(tmp_path / "a.obj")
        whole = clbvh.load_mesh(tmp_path / "a.obj")
        assert len(flatten(scene)) == whole.face_count
        return scene

    def test_objects_are_parts(self, tmp_path):
        scene = self.load(
            tmp_path,
            "vt 0 0\nvt 1 0\n"
            + 3 * "vn 0 0 1\n"
            + "f 1 2 3\n o left/side 1 \ng ignored\nf 1/1/1 2/2 3//3\nf 1 3 4\no right\nv 7 7 7\nf -1 1 2 3 \n",
        )
        assert names(scene.geometries) == names(scene.instances) == ["a", "left/side 1", "right"]
        assert [geometry.shape.face_count for geometry in scene.geometries] == [1, 2, 2]
        assert scene.geometries[1].shape.vertices.tolist() == SQUARE.tolist()
        assert scene.geometries[2].shape.vertices.tolist() == [*SQUARE[:3].tolist(), [7, 7, 7]]
        assert scene.geometries[2].shape.faces.tolist() == [[3, 0, 1], [3, 1, 2]]
        assert (scene.instances[2].transform == np.eye(4)).all()

    def test_groups_are_parts_where_no_object_is_named(self, tmp_path):
        scene = self.load(tmp_path, "g a b\nf 1 2 3\ng c\nf 1 3 4\ng a  b\nf 2 3 4\ng\nf 4 3 2\n")
        assert names(scene.geometries) == ["a", "a b", "c"]
        assert [geometry.shape.face_count for geometry in scene.geometries] == [1, 2, 1]
        assert scene.find_geometry("a b").shape.vertices.tolist() == SQUARE.tolist()

    def test_a_file_without_names_is_one_part(self, tmp_path):
        scene = self.load(tmp_path, "f 1 2 3 4\n")
        assert names(scene.geometries) == ["a"]
        # The last one is loose.
        assert len(scene.geometries[0].shape.vertices) == 4

    def test_an_object_without_faces_is_left_out(self, tmp_path):
        assert names(self.load(tmp_path, "o empty\no full\nf 1 2 3\no last").geometries) == ["full"]

    def test_a_wrong_index_is_refused_as_in_the_whole(self, tmp_path):
        (tmp_path / "a.obj").write_text(OBJ + "o a\nf 1 2 3\no b\nf 1 2 9\n")
        with pytest.raises(MeshError, match="face 1 refers to vertex 9, but there are 5"):
            clbvh.Scene().add_parts(tmp_path / "a.obj")
        with pytest.raises(MeshError, match="face 1 refers to vertex 9, but there are 5"):
            clbvh.load_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize("suffix", ["stl", "ply", "off"])
def test_other_files_are_one_part(tmp_path, suffix):
    trimesh.creation.box().export(tmp_path / f"crate.{suffix}")
    scene = clbvh.Scene()
    assert names(scene.add_parts(tmp_path / f"crate.{suffix}")) == ["crate"]
    assert scene.geometries[0].shape.face_count == 12


def test_a_file_that_cannot_be_read_is_refused(tmp_path):
    (tmp_path / "a.glb").write_bytes(b"glTF nonsense")
    for path, message in (
        (tmp_path / "gone.glb", "no such file"),
        (tmp_path / "a.glb", "glb: the file is GLB 1852796448"),
    ):
        with pytest.raises(MeshError, match=message):
            clbvh.Scene().add_parts(path)


class TestTrimesh:
    def make(self):
        scene = trimesh.Scene()
        box = trimesh.creation.box()
        scene.add_geometry(box, node_name="body", geom_name="box", transform=shifted(1, 0, 0))
        scene.graph.update("wheel a", geometry="box", matrix=np.diag([-2.0, 1, 1, 1]), frame_from="body")
        scene.add_geometry(trimesh.PointCloud([[0, 0, 0]]), node_name="dots")
        scene.add_geometry(trimesh.creation.icosphere(), node_name="ball", geom_name="ball")
        return scene

    def test_the_graph_and_its_names_are_kept(self):
        source = self.make()
        scene = clbvh.Scene()
        placed = scene.add_parts(source)
        assert placed == scene.instances
        assert set(names(placed)) == {"body", "wheel a", "ball"}
        assert names(scene.geometries) == ["box", "ball"]
        wheel = scene.find("wheel a")
        assert wheel.geometry is scene.find("body").geometry
        assert wheel.transform.tolist() == (shifted(1, 0, 0) @ np.diag([-2.0, 1, 1, 1])).tolist()
        for instance in placed:
            matrix, name = source.graph[instance.name]
            assert instance.geometry.name == name
            assert (instance.transform == matrix).all()

    def test_it_is_added_as_one_mesh_with_parts(self):
        parts, whole = clbvh.Scene(), clbvh.Scene()
        parts.add_parts(self.make())
        cart = whole.add(self.make(), name="cart")
        whole.place(cart)
        assert flatten(whole) == pytest.approx(flatten(parts), abs=1e-15)
        assert [part.name for part in cart.shape.parts] == names(parts.instances)
        assert [part.end - part.begin for part in cart.shape.parts] == [12, 12, 1280]
        assert cart.name == "cart"

    def test_one_node_is_a_mesh_without_parts(self):
        box = clbvh.Scene().add(trimesh.Scene(trimesh.creation.box()))
        assert (box.shape.face_count, box.shape.parts) == (12, ())

    def test_a_scene_without_meshes_is_refused(self):
        for empty in (trimesh.Scene(), trimesh.Scene(trimesh.PointCloud([[0, 0, 0]]))):
            with pytest.raises(SceneError, match="no node with a triangle mesh"):
                clbvh.Scene().add_parts(empty)
            with pytest.raises(SceneError, match="no node with a triangle mesh"):
                clbvh.Scene().add(empty)

    def test_a_part_that_is_no_mesh_is_named(self):
        source = trimesh.Scene()
        source.add_geometry(
            trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], process=False), geom_name="torn"
        )
        scene = clbvh.Scene()
        with pytest.raises(MeshError, match="torn: vertex 2"):
            scene.add(source)
        assert scene.geometries == ()

    def test_the_scene_can_be_exported_and_read_again(self, tmp_path):
        source = self.make()
        source.delete_geometry([name for name, thing in source.geometry.items() if not hasattr(thing, "faces")])
        source.export(tmp_path / "a.glb")
        there, here = clbvh.Scene(), clbvh.Scene()
        there.add_parts(tmp_path / "a.glb")
        here.add_parts(source)
        assert sorted(names(there.instances)) == sorted(names(here.instances))
        for instance in here.instances:
            assert there.find(instance.name).transform == pytest.approx(instance.transform, abs=1e-6)
            assert there.find(instance.name).geometry.shape.face_count == instance.geometry.shape.face_count


class TestWhole:
    def test_the_whole_is_moved(self, tmp_path):
        scene = clbvh.Scene()
        scene.add_parts(TestGltf().make(tmp_path))
        moved = clbvh.Scene()
        moved.add_parts(TestGltf().make(tmp_path), clbvh.Transform(scale=2, translate=(1, 2, 3)), mask=6)
        assert flatten(moved) == pytest.approx(flatten(scene) * 2 + [1, 2, 3])
        assert {instance.mask for instance in moved.instances} == {6}

    def test_a_scene_goes_into_another_one(self):
        inner = clbvh.Scene()
        inner.place(inner.add(clbvh.make_shape("icosphere", triangles=80)), clbvh.Transform(scale=2))
        inner.place(inner.add(clbvh.Spheres([[0, 0, 0]], 1, name="dot")), mask=3)
        outer = clbvh.Scene()
        outer.add_parts(inner, shifted(5, 0, 0))
        outer.add_parts(inner)
        assert names(outer.geometries) == ["icosphere", "dot", "icosphere 2", "dot 2"]
        assert names(outer.instances) == ["icosphere", "dot", "icosphere 2", "dot 2"]
        assert [instance.mask for instance in outer.instances] == [2**32 - 1, 3] * 2
        assert outer.instances[0].transform.tolist() == (shifted(5, 0, 0) @ np.diag([2.0, 2, 2, 1])).tolist()
        assert outer.geometries[1].shape is inner.geometries[1].shape
        inner.add_parts(inner)
        assert len(inner.instances) == 4

    def test_a_scene_is_no_geometry(self):
        with pytest.raises(SceneError, match="add it by `add_parts`"):
            clbvh.Scene().add(clbvh.Scene())

    @pytest.mark.parametrize("source", [5, None, trimesh.creation.box()])
    def test_something_without_parts_is_refused(self, source):
        with pytest.raises(SceneError, match=r"expected the path of a file, a trimesh\.Scene or a clbvh\.Scene, not"):
            clbvh.Scene().add_parts(source)

    def test_a_wrong_transform_or_mask_adds_nothing(self):
        inner = clbvh.Scene(clbvh.make_shape("icosphere", triangles=80))
        outer, far = clbvh.Scene(), clbvh.Scene()
        far.place(far.add(inner.geometries[0].shape), clbvh.Transform(scale=1e200))
        with pytest.raises(SceneError, match="the transform is singular"):
            outer.add_parts(inner, np.diag([0, 0, 0, 1]))
        with pytest.raises(SceneError, match="a mask must be"):
            outer.add_parts(inner, mask=-1)
        with pytest.raises(SceneError, match="the transform of 'icosphere' must be finite"):
            outer.add_parts(far, np.diag([1e200] * 3 + [1]))
        assert outer.geometries == ()


@pytest.mark.parametrize("seed", range(10))
def test_random_gltf_files_have_the_triangles_of_the_flattened_ones(tmp_path, seed):
    rng = np.random.default_rng(seed)
    gltf = Gltf()
    points = [gltf.add_accessor(rng.normal(size=(rng.integers(3, 9), 3)), "f4") for _ in range(3)]
    for _ in range(4):
        gltf.add_mesh(*({"attributes": {"POSITION": int(rng.choice(points))}, "mode": 6} for _ in range(2)))
    for number in range(9):
        keys = {
            "name": f"node {number}",
            "translation": rng.normal(size=3).tolist(),
            "scale": rng.normal(size=3).tolist(),
        }
        if number % 3:
            keys["mesh"] = int(rng.integers(4))
        keys["children"] = [number + 1] if number % 2 else []
        gltf.add_node(is_root=number % 2 == 1 or number == 0, **keys)
    path = gltf.write_glb(tmp_path / "a.glb")
    scene = clbvh.Scene()
    scene.add_parts(path)
    whole = clbvh.load_mesh(path)
    assert flatten(scene) == pytest.approx(whole.vertices[whole.faces], abs=1e-12)
