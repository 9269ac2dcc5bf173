"""A scene of clbvh: its first mesh, settings beside shared objects, copies and pickles."""

from __future__ import annotations

import copy
import dataclasses
import pickle

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.errors import MeshError, SceneError
from clbvh.rendering.open_scene import as_scene

BALL = clbvh.make_shape("icosphere", triangles=80)
KNOT = clbvh.make_shape("knot", triangles=200)
DOTS = clbvh.Spheres([[0, 0, 0], [5, 0, 0]], [1, 2], name="dots")
TWICE = clbvh.Transform(scale=2, rotate=(10, 20, 30), translate=(4, 5, 6))


def names(things):
    return [thing.name for thing in things]


class TestFirstMesh:
    def test_a_scene_of_a_mesh_is_that_mesh_placed_once(self):
        scene = clbvh.Scene(BALL)
        assert not scene.is_empty
        assert names(scene.geometries) == names(scene.instances) == ["icosphere"]
        assert scene.geometries[0].shape is BALL
        assert scene.snapshot().is_one_mesh

    def test_the_transform_places_it(self):
        scene = clbvh.Scene(BALL, transform=TWICE)
        matrix = scene.instances[0].transform
        assert matrix.tolist() == TWICE.matrix.tolist()
        moved = BALL.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        assert moved == pytest.approx(TWICE.apply(BALL).vertices, abs=1e-13)
        assert not scene.snapshot().is_one_mesh

    def test_a_file_is_read_when_it_is_needed(self, tmp_path):
        path = tmp_path / "crate.stl"
        scene = clbvh.Scene(path)
        assert not scene.is_empty
        assert scene.with_changes(width=10) is not scene
        copies = copy.copy(scene), pickle.loads(pickle.dumps(scene))
        with pytest.raises(MeshError, match="no such file"):
            scene.snapshot()
        trimesh.creation.box().export(path)
        for one in (scene, *copies):
            assert names(one.geometries) == ["crate"]
            assert one.snapshot() is one.snapshot()
        path.unlink()
        assert len(scene.instances) == 1

    @pytest.mark.parametrize(
        "ask",
        [
            lambda scene: scene.geometries[0],
            lambda scene: scene.instances[0],
            lambda scene: scene.snapshot().shapes[0],
            lambda scene: scene.find("icosphere"),
            lambda scene: scene.find_geometry("icosphere"),
            lambda scene: scene.instance_ids([0]),
        ],
    )
    def test_every_question_loads_it(self, ask):
        ask(clbvh.Scene(clbvh.make_shape("icosphere", triangles=80)))

    def test_what_is_added_comes_behind_it(self):
        scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=80))
        assert scene.add(BALL).id == 1
        assert scene.place(scene.geometries[1]).id == 1
        assert names(scene.instances) == ["icosphere", "icosphere 2"]

    def test_a_transform_without_a_mesh_is_refused(self):
        with pytest.raises(SceneError, match=r"give it to `Scene\.place`"):
            clbvh.Scene(transform=TWICE)

    def test_only_a_scene_of_one_mesh_is_that_mesh(self):
        scene = clbvh.Scene(BALL)
        assert scene.only_mesh().load() is BALL
        scene.add(KNOT)
        with pytest.raises(SceneError, match=r"one mesh is needed here, .* 2 geometries in 1 places"):
            scene.only_mesh()
        with pytest.raises(SceneError, match="the scene is empty: add a geometry, and place it"):
            clbvh.Scene().only_mesh()


class TestChanges:
    def test_other_settings_share_the_objects(self):
        scene = clbvh.Scene(BALL)
        wide = scene.with_changes(width=1000, shading="depth")
        wide.place(wide.add(DOTS))
        assert (scene.width, wide.width) == (800, 1000)
        assert scene.instances is wide.instances
        assert names(scene.instances) == ["icosphere", "dots"]
        assert scene.place(wide.geometries[0]).id == 2
        assert dataclasses.replace(scene, height=7).instances == scene.instances

    def test_another_mesh_or_transform_makes_other_objects(self):
        scene = clbvh.Scene(BALL)
        assert names(scene.instances) == ["icosphere"]
        assert scene.with_changes(mesh=KNOT).geometries[0].shape is KNOT
        moved = scene.with_changes(transform=TWICE)
        assert moved.instances[0].transform.tolist() == TWICE.matrix.tolist()
        assert (scene.instances[0].transform == np.eye(4)).all()
        assert names(clbvh.Scene().with_changes(mesh=BALL).instances) == ["icosphere"]

    @pytest.mark.parametrize("changes", [{"mesh": KNOT}, {"transform": TWICE}])
    def test_but_not_of_a_scene_with_other_objects(self, changes):
        scene = clbvh.Scene(BALL)
        scene.add(DOTS)
        with pytest.raises(SceneError, match="to which objects were added cannot be changed: make a new scene"):
            scene.with_changes(**changes)

    def test_scenes_are_equal_if_their_settings_and_objects_are(self):
        assert clbvh.Scene(BALL) == clbvh.Scene(BALL)
        assert clbvh.Scene() == clbvh.Scene()
        assert clbvh.Scene(BALL) != clbvh.Scene(KNOT)
        assert clbvh.Scene(BALL) != clbvh.Scene(BALL, width=5)
        assert clbvh.Scene() != 5
        assert hash(clbvh.Scene()) == hash(clbvh.Scene())
        scene, other = clbvh.Scene(BALL), clbvh.Scene(BALL)
        scene.add(DOTS)
        assert scene != other
        other.add(DOTS)
        assert scene != other
        assert scene == scene.with_changes(width=scene.width)

    def test_its_text_has_what_it_holds(self):
        assert repr(clbvh.Scene()) == "Scene()"
        scene = clbvh.Scene("gone.ply", width=5)
        assert repr(scene).startswith("Scene(mesh=MeshSource(path='gone.ply'")
        assert repr(scene).endswith("width=5)")
        scene = clbvh.Scene()
        scene.place(scene.add(BALL))
        assert repr(scene.with_changes(fov=20)) == "Scene(geometries=1, instances=1, fov=20)"

    def test_settings_cannot_be_written(self):
        with pytest.raises(dataclasses.FrozenInstanceError):
            clbvh.Scene().width = 5


@pytest.mark.parametrize("duplicate", [lambda thing: pickle.loads(pickle.dumps(thing)), copy.copy, copy.deepcopy])
class TestCopies:
    def make(self):
        scene = clbvh.Scene(BALL, transform=TWICE, width=17)
        scene.place(scene.add(DOTS), mask=3, colour=(1, 0, 0))
        return scene

    def test_a_copy_holds_the_same(self, duplicate):
        scene = self.make()
        copied = duplicate(scene)
        assert copied.width == 17
        assert copied.transform == TWICE
        mine, theirs = scene.snapshot(), copied.snapshot()
        assert theirs.names == mine.names
        assert theirs.instance_names == mine.instance_names
        for array in ("transforms", "masks", "geometry_ids", "colours"):
            assert getattr(theirs, array).tobytes() == getattr(mine, array).tobytes()
        assert theirs.shapes[0].vertices.tobytes() == BALL.vertices.tobytes()
        assert theirs.shapes[1].radii.tobytes() == DOTS.radii.tobytes()
        assert [instance.mask for instance in copied.instances] == [instance.mask for instance in scene.instances]

    def test_a_copy_is_a_scene_of_its_own(self, duplicate):
        scene = self.make()
        copied = duplicate(scene)
        for one, other in ((scene, copied), (copied, scene)):
            before = len(other.instances)
            # Of its own in every one, which shared arrays would mix up.
            matrix = np.diag([before, len(one.instances), 1, 1])
            placed = one.place(one.geometries[1], matrix, name=f"new {before}")
            assert len(other.instances) == before
            assert (placed.transform == matrix).all()
            with pytest.raises(SceneError, match="belongs to another scene"):
                other.place(one.geometries[0])
            with pytest.raises(SceneError, match="belongs to another scene"):
                other.instance_ids([one.instances[0]])
        assert scene.instances[2].transform.tolist() == np.diag([2.0, 2, 1, 1]).tolist()
        assert copied.instances[2].transform.tolist() == np.diag([3.0, 2, 1, 1]).tolist()
        assert copied.place(copied.geometries[0]).name == "icosphere 2"
        assert copied.instance_ids([copied.instances[1]]).tolist() == [1]
        assert copied.instances[1].geometry is copied.geometries[1]

    def test_a_state_is_still_read_only(self, duplicate):
        state = duplicate(self.make().snapshot())
        with pytest.raises(ValueError, match="read-only"):
            state.transforms[0] = 0


@pytest.mark.parametrize("duplicate", [lambda thing: pickle.loads(pickle.dumps(thing)), copy.deepcopy])
def test_handles_that_are_copied_with_their_scene_stay_its(duplicate):
    scene = clbvh.Scene(BALL)
    copied, handle = duplicate([scene, scene.instances[0]])
    assert copied.instance_ids([handle]).tolist() == [0]
    assert copied.instances[0] is handle


class TestSceneLike:
    def test_objects_become_scenes(self):
        source = trimesh.Scene()
        source.add_geometry(trimesh.creation.box(), node_name="crate")
        assert names(as_scene(source).instances) == ["crate"]
        assert as_scene(DOTS).geometries[0].shape is DOTS
        assert names(as_scene(DOTS).instances) == ["dots"]
        scene = clbvh.Scene()
        assert as_scene(scene) is scene

    def test_a_saved_scene_is_opened(self, tmp_path):
        clbvh.Scene(BALL, width=33).save(tmp_path / "a.scene")
        scene = as_scene(tmp_path / "a.scene")
        assert scene.width == 33
        assert names(scene.instances) == ["icosphere"]
