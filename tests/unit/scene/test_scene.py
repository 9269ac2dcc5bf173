"""A scene: what is added, what is refused, names and ids, copies and pickles."""

from __future__ import annotations

import copy
import pickle
import threading
import weakref

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.errors import MeshError, SceneError
from clbvh.rendering.open_scene import as_scene
from clbvh.scene.state import SceneState

BALL = clbvh.make_shape("icosphere", triangles=80)
KNOT = clbvh.make_shape("knot", triangles=200)
DOTS = clbvh.Spheres([[0, 0, 0], [5, 0, 0]], [1, 2], name="dots")
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]
ALL_BITS = 2**32 - 1


def shifted(*translation):
    return clbvh.Transform(translate=translation).matrix


@pytest.fixture
def scene():
    """Two geometries, three instances."""
    scene = clbvh.Scene()
    ball, dots = scene.add(BALL, name="ball"), scene.add(DOTS)
    scene.place(ball, name="first")
    scene.place(dots, shifted(1, 2, 3), mask=5)
    scene.place(ball, shifted(7, 0, 0))
    return scene


class TestEmpty:
    def test_a_scene_is_empty(self):
        scene = clbvh.Scene()
        assert scene.is_empty
        assert scene.geometries == scene.instances == ()
        state = scene.snapshot()
        assert (state.geometry_count, state.instance_count) == (0, 0)
        assert state.transforms.shape == (0, 4, 4)
        assert not state.is_one_mesh
        assert repr(scene) == "Scene(geometries=0, instances=0)"

    def test_a_geometry_that_is_not_placed_is_not_seen(self):
        scene = clbvh.Scene()
        scene.add(BALL)
        assert scene.is_empty
        assert not scene.snapshot().is_one_mesh


class TestSource:
    def test_it_is_placed_once_where_it_is(self, tmp_path):
        trimesh.creation.box().export(tmp_path / "crate.stl")
        for source, name in ((BALL, "icosphere"), (DOTS, "dots"), (tmp_path / "crate.stl", "crate")):
            scene = clbvh.Scene(source)
            assert [thing.name for thing in (*scene.geometries, *scene.instances)] == [name, name]
            assert scene.snapshot().is_one_mesh == (source is not DOTS)
        assert clbvh.Scene(BALL).geometries[0].shape is BALL

    def test_what_is_added_comes_behind_it(self):
        scene = clbvh.Scene(BALL)
        assert scene.add(BALL).id == 1
        assert scene.place(scene.geometries[1]).id == 1
        assert [instance.name for instance in scene.instances] == ["icosphere", "icosphere 2"]

    def test_anything_to_draw_is_a_scene(self):
        source = trimesh.Scene()
        source.add_geometry(trimesh.creation.box(), node_name="crate")
        scene, view = as_scene(source)
        assert [instance.name for instance in scene.instances] == ["crate"]
        assert view == clbvh.View()
        assert as_scene(DOTS)[0].geometries[0].shape is DOTS
        assert as_scene(scene)[0] is scene


class TestAdd:
    def test_ids_count_up_and_handles_say_what_they_are(self, scene):
        assert [geometry.id for geometry in scene.geometries] == [0, 1]
        assert [instance.id for instance in scene.instances] == [0, 1, 2]
        assert scene.geometries[0].shape is BALL
        assert scene.geometries[1].shape is DOTS
        assert [instance.geometry.id for instance in scene.instances] == [0, 1, 0]
        assert repr(scene.instances[0]) == "Instance(0, 'first', of='ball')"
        assert repr(scene.geometries[1]) == "Geometry(1, 'dots', Spheres('dots', count=2))"

    def test_every_form_of_a_mesh_is_taken(self, tmp_path):
        scene = clbvh.Scene()
        box = trimesh.creation.box()
        box.export(tmp_path / "crate.stl")
        for source, name in (
            (BALL, "icosphere"),
            (box, "Trimesh"),
            (tmp_path / "crate.stl", "crate"),
            (str(tmp_path / "crate.stl"), "crate 2"),
            (TRIANGLE, "mesh"),
            (DOTS, "dots"),
        ):
            assert scene.add(source).name == name

    @pytest.mark.parametrize("source", [None, 5, [], trimesh.PointCloud([[0, 0, 0]]), clbvh.Mesh])
    def test_anything_else_is_refused(self, source):
        scene = clbvh.Scene()
        with pytest.raises(MeshError, match=r"expected clbvh\.Spheres, a trimesh\.Scene, a clbvh\.Mesh"):
            scene.add(source)
        assert scene.geometries == ()

    def test_a_geometry_is_not_added_twice(self, scene):
        with pytest.raises(SceneError, match="is in a scene already: place it again, or add its shape"):
            clbvh.Scene().add(scene.geometries[0])

    def test_a_bad_mesh_is_refused_by_the_mesh(self):
        with pytest.raises(MeshError, match="not finite"):
            clbvh.Scene().add(([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]]))


class TestNames:
    def test_names_of_the_source_are_numbered(self):
        scene = clbvh.Scene()
        assert [scene.add(BALL).name for _ in range(3)] == ["icosphere", "icosphere 2", "icosphere 3"]
        scene.add(KNOT, name="icosphere 4")
        assert scene.add(BALL).name == "icosphere 5"
        assert scene.find_geometry("icosphere 3").id == 2

    def test_names_of_instances_come_from_their_geometry(self, scene):
        assert [instance.name for instance in scene.instances] == ["first", "dots", "ball"]
        assert scene.place(scene.geometries[0]).name == "ball 2"

    def test_ten_thousand_names_are_unique(self, scene):
        placed = scene.place_many(scene.geometries[0], np.tile(np.eye(4), (10_000, 1, 1)))
        assert len({instance.name for instance in scene.instances}) == 10_003
        assert placed[-1].name == "ball 10001"
        assert scene.find("ball 777").id == 3 + 775

    def test_a_name_that_is_taken_is_refused(self, scene):
        with pytest.raises(SceneError, match="the scene has a geometry with the name 'ball' already"):
            scene.add(KNOT, name="ball")
        with pytest.raises(SceneError, match="the scene has an instance with the name 'first' already"):
            scene.place(scene.geometries[1], name="first")
        assert len(scene.geometries) == 2
        assert len(scene.instances) == 3

    @pytest.mark.parametrize("name", ["", "  ", 5, b"ball", "\ud800", ("a", "b")])
    def test_something_that_is_no_name_is_refused(self, scene, name):
        with pytest.raises(SceneError, match="must be a text"):
            scene.add(KNOT, name=name)
        with pytest.raises(SceneError, match="must be a text"):
            scene.place(scene.geometries[0], name=name)

    @pytest.mark.parametrize(("given", "name"), [("", "geometry"), (" a ", "a"), ("\ud800b", "?b"), (5, "5")])
    def test_a_mesh_without_a_proper_name_gets_one(self, given, name):
        scene = clbvh.Scene()
        geometry = scene.add(clbvh.Mesh.from_arrays(*TRIANGLE, name=given))
        assert geometry.name == scene.place(geometry).name == name

    def test_geometries_and_instances_may_have_the_same_name(self, scene):
        assert scene.find_geometry("ball").id == 0
        assert scene.find("ball").id == 2

    def test_an_unknown_name_is_answered_by_those_that_are_known(self, scene):
        with pytest.raises(SceneError, match=r"no instance 'car'; it has 'first', 'dots', 'ball'$"):
            scene.find("car")
        with pytest.raises(SceneError, match=r"no geometry 'car'; it has 'ball', 'dots'$"):
            scene.find_geometry("car")
        with pytest.raises(SceneError, match="no instance 'car'; it has none"):
            clbvh.Scene().find("car")
        with pytest.raises(SceneError, match=r"no instance \['ball'\]"):
            scene.find(["ball"])


class TestPlace:
    def test_the_transform_is_a_copy_in_both_directions(self, scene):
        matrix = shifted(1, 1, 1)
        instance = scene.place(scene.geometries[0], matrix)
        matrix[:] = 0
        instance.transform[:] = 0
        assert instance.transform.tolist() == shifted(1, 1, 1).tolist()

    def test_a_transform_of_a_scene_is_taken(self, scene):
        instance = scene.place(scene.geometries[0], clbvh.Transform(scale=3))
        assert instance.transform.tolist() == np.diag([3.0, 3, 3, 1]).tolist()

    def test_a_bad_transform_places_nothing(self, scene):
        for wrong in (np.zeros((4, 4)), np.eye(3), np.diag([1, 1, np.nan, 1])):
            with pytest.raises(SceneError, match="the transform "):
                scene.place(scene.geometries[0], wrong)
        assert len(scene.instances) == 3
        assert scene.place(scene.geometries[0], name="next").id == 3

    @pytest.mark.parametrize("mask", [-1, 2**32, 1.0, True, None, "1"])
    def test_a_mask_has_32_bits(self, scene, mask):
        with pytest.raises(SceneError, match="a mask must be a whole number from 0"):
            scene.place(scene.geometries[0], mask=mask)
        with pytest.raises(SceneError, match="a mask must be a whole number from 0"):
            scene.place_many(scene.geometries[0], np.eye(4)[None], mask=mask)

    def test_masks_are_kept(self, scene):
        scene.place(scene.geometries[0], mask=np.uint32(ALL_BITS))
        scene.place(scene.geometries[0], mask=0)
        assert [instance.mask for instance in scene.instances] == [ALL_BITS, 5, ALL_BITS, ALL_BITS, 0]
        assert scene.snapshot().masks.tolist() == [ALL_BITS, 5, ALL_BITS, ALL_BITS, 0]

    def test_a_geometry_of_another_scene_is_refused(self, scene):
        other = clbvh.Scene()
        ball = other.add(BALL, name="ball")
        for place in (scene.place, lambda geometry: scene.place_many(geometry, np.eye(4)[None])):
            with pytest.raises(SceneError, match=r"Geometry\(0, 'ball', .* belongs to another scene"):
                place(ball)
            with pytest.raises(SceneError, match=r"expected a geometry that Scene\.add returned, not 0"):
                place(0)
            with pytest.raises(SceneError, match=r"not Mesh\('icosphere'"):
                place(BALL)
            with pytest.raises(SceneError, match="not Instance"):
                place(scene.instances[0])

    def test_many_are_placed_in_their_order(self, scene):
        matrices = np.tile(np.eye(4), (4, 1, 1))
        matrices[:, 0, 3] = range(4)
        placed = scene.place_many(scene.geometries[1], matrices, names=list("abcd"), mask=9)
        assert [instance.id for instance in placed] == [3, 4, 5, 6]
        assert [instance.name for instance in placed] == list("abcd")
        assert [instance.transform[0, 3] for instance in placed] == [0, 1, 2, 3]
        assert scene.snapshot().transforms[3:].tobytes() == matrices.tobytes()
        assert scene.instances[3:] == placed
        assert scene.place_many(scene.geometries[0], np.empty((0, 4, 4))) == ()

    def test_many_are_placed_or_none(self, scene):
        matrices = np.tile(np.eye(4), (3, 1, 1))
        for names in (["a", "b"], "abc", ["a", "b", "a"], ["a", "b", "first"], ["a", "b", ""]):
            with pytest.raises(SceneError, match="name"):
                scene.place_many(scene.geometries[0], matrices, names=names)
        matrices[2, 0, 0] = 0
        with pytest.raises(SceneError, match="transform 2 is singular"):
            scene.place_many(scene.geometries[0], matrices)
        assert len(scene.instances) == 3
        assert [instance.name for instance in scene.place_many(scene.geometries[0], matrices[:1], names=["a"])] == ["a"]


class TestSnapshot:
    def test_it_has_what_tracers_need(self, scene):
        state = scene.snapshot()
        assert isinstance(state, SceneState)
        assert state.shapes == (BALL, DOTS)
        assert state.names == ("ball", "dots")
        assert state.geometry_ids.dtype == np.int32
        assert state.geometry_ids.tolist() == [0, 1, 0]
        assert state.transforms.tolist() == [np.eye(4).tolist(), shifted(1, 2, 3).tolist(), shifted(7, 0, 0).tolist()]
        assert state.masks.dtype == np.uint32
        assert state.instance_names == ("first", "dots", "ball")

    def test_it_stays_while_the_scene_grows(self, scene):
        before = scene.snapshot()
        assert scene.snapshot() is before
        assert scene.instances is scene.instances
        transforms = before.transforms.copy()
        for _ in range(40):
            scene.place(scene.geometries[1], shifted(9, 9, 9))
        assert before.instance_count == 3
        assert (before.transforms == transforms).all()
        after = scene.snapshot()
        assert after is not before
        assert after.instance_count == 43
        assert (after.transforms[:3] == transforms).all()
        assert (after.transforms[3:] == shifted(9, 9, 9)).all()

    def test_a_new_geometry_is_seen_before_it_is_placed(self, scene):
        assert scene.snapshot().geometry_count == len(scene.geometries) == 2
        scene.add(KNOT)
        assert scene.snapshot().geometry_count == len(scene.geometries) == 3

    def test_it_cannot_be_written(self, scene):
        state = scene.snapshot()
        for array in (state.geometry_ids, state.transforms, state.masks):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0

    def test_changed_copies_leave_it_alone(self, scene):
        state = scene.snapshot()
        moved = state.with_transforms(np.array([2, 0]), np.stack([shifted(1, 0, 0), shifted(2, 0, 0)]))
        assert moved.transforms[:, 0, 3].tolist() == [2, 1, 1]
        assert state.transforms[:, 0, 3].tolist() == [0, 1, 7]
        assert state.with_shape(1, KNOT).shapes == (BALL, KNOT)
        assert state.with_shape(0, KNOT).shapes == (KNOT, DOTS)
        assert state.shapes == (BALL, DOTS)

    def test_one_mesh_is_recognised(self):
        scene = clbvh.Scene()
        dots, ball = scene.add(DOTS), scene.add(BALL)
        scene.place(ball)
        state = scene.snapshot()
        assert state.is_one_mesh
        assert not state.with_transforms([0], shifted(0, 0, 1e-300)[None]).is_one_mesh
        assert not state.with_shape(1, DOTS).is_one_mesh
        scene.place(dots)
        assert not scene.snapshot().is_one_mesh
        masked = clbvh.Scene()
        masked.place(masked.add(BALL), mask=1)
        assert not masked.snapshot().is_one_mesh


class TestIds:
    def test_handles_become_ids(self, scene):
        a, b, c = scene.instances
        assert scene.instance_ids(a).tolist() == [0]
        assert scene.instance_ids(1).tolist() == [1]
        assert scene.instance_ids([c, a]).tolist() == [2, 0]
        assert scene.instance_ids(scene.instances).tolist() == [0, 1, 2]
        assert scene.instance_ids((b, 0, np.int32(2))).tolist() == [1, 0, 2]
        assert scene.instance_ids(np.array([2, 1], np.uint8)).tolist() == [2, 1]
        assert scene.instance_ids([]).tolist() == []
        assert scene.instance_ids([]).dtype == np.int64

    @pytest.mark.parametrize("wrong", [-1, 3, 2**70, -(2**70)])
    def test_an_id_out_of_range_is_refused(self, scene, wrong):
        with pytest.raises(SceneError, match=r"there is no instance -?\d+: the scene has 3"):
            scene.instance_ids([0, wrong])

    @pytest.mark.parametrize(
        "wrong", ["first", [None], [True], [1.0], True, 5.0, None, [[0, 1]], np.eye(2), np.array([0.0])]
    )
    def test_something_else_is_refused(self, scene, wrong):
        with pytest.raises(SceneError, match=r"expected (an instance|instances) that Scene\.place returned"):
            scene.instance_ids(wrong)

    def test_an_instance_of_another_scene_is_refused(self, scene):
        other = clbvh.Scene(BALL)
        with pytest.raises(SceneError, match=r"Instance\(0, 'icosphere', .* belongs to another scene"):
            scene.instance_ids([other.instances[0]])
        with pytest.raises(SceneError, match="expected an instance"):
            scene.instance_ids([scene.geometries[0]])


@pytest.mark.parametrize("duplicate", [lambda thing: pickle.loads(pickle.dumps(thing)), copy.copy, copy.deepcopy])
class TestCopies:
    def test_a_copy_holds_the_same(self, scene, duplicate):
        scene.place(scene.geometries[0], colour=(1, 0, 0))
        copied = duplicate(scene)
        mine, theirs = scene.snapshot(), copied.snapshot()
        assert theirs.names == mine.names
        assert theirs.instance_names == mine.instance_names
        for array in ("transforms", "masks", "geometry_ids", "colours"):
            assert getattr(theirs, array).tobytes() == getattr(mine, array).tobytes()
        assert theirs.shapes[0].vertices.tobytes() == BALL.vertices.tobytes()
        assert theirs.shapes[1].radii.tobytes() == DOTS.radii.tobytes()
        assert [instance.mask for instance in copied.instances] == [instance.mask for instance in scene.instances]

    def test_a_copy_is_a_scene_of_its_own(self, scene, duplicate):
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
        assert scene.instances[3].transform.tolist() == np.diag([3.0, 3, 1, 1]).tolist()
        assert copied.instances[3].transform.tolist() == np.diag([4.0, 3, 1, 1]).tolist()
        assert copied.place(copied.geometries[0]).name == "ball 2"
        assert copied.instance_ids([copied.instances[1]]).tolist() == [1]
        assert copied.instances[1].geometry is copied.geometries[1]

    def test_a_state_is_still_read_only(self, scene, duplicate):
        state = duplicate(scene.snapshot())
        with pytest.raises(ValueError, match="read-only"):
            state.transforms[0] = 0


@pytest.mark.parametrize("duplicate", [lambda thing: pickle.loads(pickle.dumps(thing)), copy.deepcopy])
def test_handles_that_are_copied_with_their_scene_stay_its(duplicate):
    scene = clbvh.Scene(BALL)
    copied, handle = duplicate([scene, scene.instances[0]])
    assert copied.instance_ids([handle]).tolist() == [0]
    assert copied.geometry_id(copied.geometries[0]) == copied.geometry_id(handle.geometry) == 0


def test_a_scene_ends_with_its_last_reference():
    scene = clbvh.Scene(BALL)
    seen = weakref.ref(scene)
    del scene
    assert seen() is None


@pytest.mark.parametrize("thread_count", [8])
def test_threads_may_add_to_one_scene(thread_count):
    scene = clbvh.Scene(BALL)
    count = 200
    seen = []

    def work():
        ball = scene.add(BALL)
        for _ in range(count):
            scene.place(ball, shifted(ball.id, 0, 0))
            seen.append(scene.snapshot())

    threads = [threading.Thread(target=work) for _ in range(thread_count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    state = scene.snapshot()
    assert state.instance_count == 1 + thread_count * count
    assert len(set(state.instance_names)) == state.instance_count
    assert len(set(state.names)) == state.geometry_count == 1 + thread_count
    assert [instance.id for instance in scene.instances] == list(range(state.instance_count))
    for one in (*seen, state):
        assert (one.transforms[:, 0, 3] == one.geometry_ids).all()
        assert len(one.instance_names) == one.instance_count
