"""A scene: what is added and placed, names and ids, colours and materials, snapshots and copies."""

import copy
import pickle
import threading

import numpy as np
import pytest

import clbvh
from clbvh import MeshError, SceneError
from clbvh.scene.state import dress_shapes

BALL = clbvh.make_shape("icosphere", triangles=80)
KNOT = clbvh.make_shape("knot", triangles=200)
DOTS = clbvh.Spheres([[0, 0, 0], [5, 0, 0]], [1, 2], name="dots", materials=(clbvh.Material("dot"),))
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]
ALL_BITS = 2**32 - 1
RED = (1.0, 0.25, 0.0)
GOLD = clbvh.Material("gold", metallic=1.0)
TILES = clbvh.Material("tiles", base_colour_texture=clbvh.Texture("t", np.zeros((2, 3, 4), np.uint8)))
THREE = np.tile(np.eye(4), (3, 1, 1))


def shifted(*translation):
    return clbvh.Transform(translate=translation).matrix


def names(things):
    return [thing.name for thing in things]


@pytest.fixture
def scene():
    """Two geometries, three instances."""
    scene = clbvh.Scene()
    ball, dots = scene.add(BALL, name="ball"), scene.add(DOTS)
    scene.place(ball, name="first")
    scene.place(dots, shifted(1, 2, 3), mask=5, colour=RED)
    scene.place(ball, shifted(7, 0, 0), material=GOLD)
    return scene


def same(first, second):
    """Check that two scenes hold the same, but for the pixels of textures."""
    mine, theirs = first.snapshot(), second.snapshot()
    assert (mine.names, mine.instance_names) == (theirs.names, theirs.instance_names)
    for array in ("transforms", "masks", "geometry_ids", "colours", "material_ids"):
        assert getattr(mine, array).dtype == getattr(theirs, array).dtype
        assert getattr(mine, array).tobytes() == getattr(theirs, array).tobytes()
    assert names(mine.materials) == names(theirs.materials)
    for one, other in zip(mine.shapes, theirs.shapes, strict=True):
        assert (type(one), one.name, one.fingerprint) == (type(other), other.name, other.fingerprint)
        for array in ("vertices", "faces") if isinstance(one, clbvh.Mesh) else ("centres", "radii"):
            assert getattr(one, array).tobytes() == getattr(other, array).tobytes()


def test_what_is_no_shape_is_not_added(scene):
    for source in (None, 5, [], clbvh.Mesh):
        with pytest.raises(MeshError, match=r"expected clbvh\.Spheres, a clbvh\.Mesh"):
            scene.add(source)
    with pytest.raises(SceneError, match="is in a scene already: place it again, or add its shape"):
        scene.add(scene.geometries[0])
    with pytest.raises(SceneError, match="add it by `add_parts`"):
        scene.add(clbvh.Scene())
    assert len(scene.geometries) == 2


def test_names_are_numbered_where_they_are_taken():
    scene = clbvh.Scene()
    assert [scene.add(BALL).name for _ in range(3)] == ["icosphere", "icosphere 2", "icosphere 3"]
    scene.add(KNOT, name="icosphere 4")
    assert scene.add(BALL).name == "icosphere 5"
    assert scene.find_geometry("icosphere 3").id == 2
    placed = scene.place_many(scene.geometries[0], np.tile(np.eye(4), (10_000, 1, 1)))
    assert len(set(names(placed))) == 10_000
    assert placed[-1].name == "icosphere 10000"
    assert scene.find("icosphere 777").id == 776


def test_a_mesh_without_a_proper_name_gets_one():
    for given, name in (("", "geometry"), (" a ", "a"), ("\ud800b", "?b"), (5, "5")):
        scene = clbvh.Scene(clbvh.Mesh.from_arrays(*TRIANGLE, name=given))
        assert names(scene.geometries) == names(scene.instances) == [name]


def test_names_that_are_taken_unknown_or_none_are_refused(scene):
    ball = scene.geometries[0]
    for call, message in (
        (lambda: scene.add(KNOT, name="ball"), "the scene has a geometry with the name 'ball' already"),
        (lambda: scene.place(ball, name="first"), "the scene has an instance with the name 'first' already"),
        (lambda: scene.find("car"), r"no instance 'car'; it has 'first', 'dots', 'ball'$"),
        (lambda: scene.find_geometry("car"), r"no geometry 'car'; it has 'ball', 'dots'$"),
    ):
        with pytest.raises(SceneError, match=message):
            call()
    for name in ("", "  ", 5, b"ball", "\ud800", ("a", "b")):
        with pytest.raises(SceneError, match="the name of a geometry must be a text"):
            scene.add(KNOT, name=name)
        with pytest.raises(SceneError, match="the name of an instance must be a text"):
            scene.place(ball, name=name)
    assert (len(scene.geometries), len(scene.instances)) == (2, 3)


def test_instances_have_what_they_were_placed_with(scene):
    matrix = shifted(1, 1, 1)
    last = scene.place(scene.geometries[0], matrix, mask=0)
    matrix[:] = last.transform[:] = 0
    assert last.transform.tolist() == shifted(1, 1, 1).tolist()
    assert names(scene.instances) == ["first", "dots", "ball", "ball 2"]
    assert [each.id for each in scene.instances] == [0, 1, 2, 3]
    assert [each.geometry.id for each in scene.instances] == [0, 1, 0, 0]
    assert [each.mask for each in scene.instances] == [ALL_BITS, 5, ALL_BITS, 0]
    assert [each.colour for each in scene.instances] == [None, RED, None, None]
    assert [each.material for each in scene.instances] == [None, None, GOLD, None]
    assert scene.find("ball").id == 2


def test_what_cannot_be_placed_places_nothing(scene):
    ball, other = scene.geometries[0], clbvh.Scene(BALL).geometries[0]
    rows = [({"mask": mask}, "a mask must be a whole number") for mask in (-1, 2**32, 1.0, True, None, "1")]
    colours = (1, 2), "red", (1, 2, np.nan), [[1, 2, 3]], [(1, 2), 3, 4], (1j, 0, 0), True
    rows += [({"colour": colour}, "three finite numbers") for colour in colours]
    rows += [({"material": material}, r"must be a clbvh\.Material") for material in ("gold", {}, clbvh.Material)]
    for values, message in rows:
        with pytest.raises(SceneError, match=message):
            scene.place(ball, **values)
        with pytest.raises(SceneError, match=message):
            scene.place_many(ball, THREE, **values)
    for geometry, message in (
        (other, r"Geometry\(0, 'icosphere', .* belongs to another scene"),
        (0, r"expected a geometry that Scene\.add returned, or its name, not 0"),
        ("nobody", "has no geometry 'nobody'"),
        (scene.instances[0], "not Instance"),
    ):
        with pytest.raises(SceneError, match=message):
            scene.place(geometry)
    with pytest.raises(SceneError, match="the transform is singular"):
        scene.place(ball, np.diag([0, 0, 0, 1]))
    assert scene.place(ball, name="next").id == 3


def test_many_are_placed_in_their_order_or_none(scene):
    matrices = THREE.copy()
    matrices[:, 0, 3] = range(3)
    placed = scene.place_many(scene.geometries[1], matrices, names=list("abc"), mask=9)
    assert [each.id for each in placed] == [3, 4, 5]
    assert names(placed) == list("abc")
    assert [each.transform[0, 3] for each in placed] == [0, 1, 2]
    assert scene.snapshot().transforms[3:].tobytes() == matrices.tobytes()
    assert scene.place_many(scene.geometries[0], np.empty((0, 4, 4))) == ()
    for taken in (["d", "e"], "def", ["d", "e", "d"], ["d", "e", "first"], ["d", "e", ""]):
        with pytest.raises(SceneError, match="name"):
            scene.place_many(scene.geometries[0], matrices, names=taken)
    matrices[2, 0, 0] = 0
    with pytest.raises(SceneError, match="transform 2 is singular"):
        scene.place_many(scene.geometries[0], matrices)
    assert len(scene.instances) == 6
    assert scene.place(scene.geometries[0], name="d").id == 6


def test_a_snapshot_stays_while_the_scene_grows(scene):
    before = scene.snapshot()
    assert scene.snapshot() is before
    assert (before.shapes, before.names) == ((BALL, DOTS), ("ball", "dots"))
    assert before.masks.tolist() == [ALL_BITS, 5, ALL_BITS]
    transforms = before.transforms.copy()
    for _ in range(40):
        scene.place(scene.geometries[1], shifted(9, 9, 9))
    assert (before.instance_count, scene.snapshot().instance_count) == (3, 43)
    assert (before.transforms == transforms).all()
    for state in (before, copy.deepcopy(before), pickle.loads(pickle.dumps(before))):
        for array in (state.geometry_ids, state.transforms, state.masks, state.colours, state.material_ids):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0


def test_one_mesh_is_recognised():
    unseen = clbvh.Scene()
    unseen.add(BALL)
    assert unseen.is_empty
    assert unseen.snapshot().lone_shape is None
    scene = clbvh.Scene(BALL)
    state = scene.snapshot()
    assert state.lone_shape is not None
    assert state.with_transforms([0], shifted(0, 0, 1e-300)[None]).lone_shape is None
    scene.add(DOTS)
    assert scene.snapshot().lone_shape is not None
    scene.place(scene.geometries[1])
    assert scene.snapshot().lone_shape is None
    masked = clbvh.Scene()
    masked.place(masked.add(BALL), mask=1)
    assert masked.snapshot().lone_shape is None


def test_handles_become_ids(scene):
    a, b, c = scene.instances
    for given, ids in (
        (a, [0]),
        (1, [1]),
        ([c, a], [2, 0]),
        (scene.instances, [0, 1, 2]),
        ((b, 0, np.int32(2)), [1, 0, 2]),
        (np.array([2, 1], np.uint8), [2, 1]),
        ([], []),
        (b.name, [1]),
        ([c.name, 0, np.str_(b.name)], [2, 0, 1]),
    ):
        found = scene.instance_ids(given)
        assert (found.tolist(), found.dtype) == (ids, np.int64)
    for geometry in scene.geometries:
        assert scene.geometry_id(geometry) == scene.geometry_id(geometry.name) == geometry.id
    for wrong in (-1, 3, 2**70):
        with pytest.raises(SceneError, match=r"there is no instance -?\d+: the scene has 3"):
            scene.instance_ids([0, wrong])
    for wrong in ("nobody", [0, "nobody"]):
        with pytest.raises(SceneError, match=r"the scene has no instance 'nobody'; it has 'first', "):
            scene.instance_ids(wrong)
    for wrong in ([None], [True], [1.0], True, 5.0, None, np.eye(2), scene.geometries[:1]):
        with pytest.raises(SceneError, match=r"expected (an instance|instances) that Scene\.place returned"):
            scene.instance_ids(wrong)
    with pytest.raises(SceneError, match=r"Instance\(0, 'icosphere', .* belongs to another scene"):
        scene.instance_ids([clbvh.Scene(BALL).instances[0]])


@pytest.mark.parametrize("duplicate", [lambda thing: pickle.loads(pickle.dumps(thing)), copy.copy, copy.deepcopy])
def test_a_copy_holds_the_same_and_goes_its_own_way(scene, duplicate):
    copied = duplicate(scene)
    same(scene, copied)
    for one, other in ((scene, copied), (copied, scene)):
        before = len(other.instances)
        # Of its own in every one, which shared arrays would mix up.
        placed = one.place(one.geometries[1], shifted(before, 0, 0), material=clbvh.Material(f"new {before}"))
        assert len(other.instances) == before
        assert (placed.transform == shifted(before, 0, 0)).all()
        with pytest.raises(SceneError, match="belongs to another scene"):
            other.place(one.geometries[0])
    assert copied.place(copied.geometries[0]).name == "ball 2"
    assert copied.instances[1].geometry is copied.geometries[1]
    assert names(scene.snapshot().materials) == ["gold", "new 3"]
    if duplicate is not copy.copy:
        again, handle = duplicate([scene, scene.instances[0]])
        assert again.instance_ids([handle]).tolist() == [0]


def test_threads_may_add_to_one_scene():
    scene, seen = clbvh.Scene(BALL), []

    def work():
        ball = scene.add(BALL)
        for _ in range(200):
            scene.place(ball, shifted(ball.id, 0, 0))
            seen.append(scene.snapshot())

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    state = scene.snapshot()
    assert len(set(state.instance_names)) == 1601
    assert [instance.id for instance in scene.instances] == list(range(1601))
    for one in (*seen, state):
        assert (one.transforms[:, 0, 3] == one.geometry_ids).all()
        assert len(one.instance_names) == one.instance_count


def make_painted():
    """A painted ball and spheres, and instances of both in materials of their own."""
    looks = {"uvs": np.zeros((80, 3, 2)), "colours": np.full((80, 3, 4), 9, np.uint8)}
    own = clbvh.Appearance(materials=(clbvh.Material("own"),), **looks)
    scene = clbvh.Scene()
    painted, dots = scene.add(clbvh.Mesh.from_arrays(BALL.vertices, BALL.faces, appearance=own)), scene.add(DOTS)
    scene.place(painted)
    scene.place(painted, material=GOLD)
    scene.place_many(dots, THREE[:2], material=TILES)
    scene.place(painted, material=clbvh.Material("gold", metallic=1.0))
    scene.place(dots, material=GOLD)
    return scene


def test_a_geometry_has_one_shape_for_each_material_which_shares_its_arrays():
    shapes, shape_ids = dress_shapes(make_painted().snapshot())
    assert shape_ids.tolist() == [0, 2, 4, 4, 2, 3]
    assert [shape.appearance.materials[0].name for shape in shapes] == ["own", "dot", "gold", "gold", "tiles"]
    assert shapes[2].vertices is shapes[0].vertices
    assert shapes[2].appearance.colours is None
    plain = clbvh.Scene(BALL).snapshot()
    assert dress_shapes(plain)[0] is plain.shapes
