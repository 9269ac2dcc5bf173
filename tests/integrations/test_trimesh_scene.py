"""The ray engine of a scene of trimesh: against its flattened mesh, and that it follows a scene that changes."""

import copy
import inspect
import pickle
import threading

import numpy as np
import pytest
import trimesh

from clbvh import Scene
from clbvh.errors import ConfigError, MeshError, QueryError, SceneError
from clbvh.integrations.trimesh import RayMeshIntersector, SceneRay, tracers
from clbvh.trace.tracer import Tracer

TO = trimesh.transformations.translation_matrix
# Rays near an edge may hit either side of it: transformed vertices are rounded.
MOST_DIFFERENT = 0.002


@pytest.fixture
def scene():
    """Three geometries under five nodes, one below another one; scaled, mirrored and sheared; a path and points."""
    made = trimesh.Scene()
    made.add_geometry(trimesh.creation.torus(1.0, 0.3), node_name="ring", geom_name="torus")
    made.add_geometry(trimesh.creation.box(), node_name="crate", geom_name="box", transform=TO([2.0, 0.3, 0]))
    mirror = np.diag([1.5, -0.7, 1.0, 1.0])
    made.graph.update("mirrored", "crate", geometry="box", matrix=mirror @ TO([0.3, 2.0, 0.1]))
    shear = np.eye(4)
    shear[0, 1], shear[:3, 3] = 0.5, [-2, 0.5, 0]
    made.add_geometry(trimesh.creation.icosphere(subdivisions=2), node_name="ball", geom_name="ball", transform=shear)
    made.graph.update("second ring", geometry="torus", matrix=trimesh.transformations.rotation_matrix(1.1, [1, 2, 3]))
    made.add_geometry(trimesh.load_path(np.array([[0, 0, 0], [1, 1, 1.0]])), node_name="line")
    made.add_geometry(trimesh.PointCloud([[0, 0, 0.0]]), node_name="dots")
    return made


@pytest.fixture
def ray(scene, session):
    engine = SceneRay(scene, device=session.info.number)
    yield engine
    engine.close()


@pytest.fixture(scope="module")
def rays():
    generator = np.random.default_rng(7)
    origins = generator.uniform(-4, 4, (4000, 3))
    return origins, generator.uniform(-2, 2, (4000, 3)) - origins


@pytest.fixture
def work(monkeypatch):
    """What was opened of a scene, moved and deformed."""
    done = []
    new_tracer = tracers.Tracer

    def open_tracer(source, **options):
        done.extend(["Tracer"] * isinstance(source, Scene))
        return new_tracer(source, **options)

    def note(owner, name):
        function = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *a, **k: done.append(name) or function(*a, **k))

    monkeypatch.setattr(tracers, "Tracer", open_tracer)
    note(Tracer, "set_transforms")
    note(Tracer, "set_vertices")
    return done


def flatten(scene):
    """The engine of the flattened mesh, and the first face of each node in it."""
    parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
    return RayMeshIntersector(scene.to_mesh()), np.cumsum([0, *(len(part.faces) for part in parts)])[:-1]


def check_like_flattened(ray, rays):
    flat, first_face = flatten(ray.scene)
    index_tri, index_node = ray.intersects_first(*rays)
    known = flat.intersects_first(*rays)
    found = np.where(index_node < 0, -1, first_face[index_node] + index_tri)
    assert (known >= 0).mean() > 0.2
    assert (found != known).mean() <= MOST_DIFFERENT
    np.testing.assert_array_equal(ray.intersects_any(*rays), index_node >= 0)

    locations, index_ray, index_tri, index_node = ray.intersects_location(*rays)
    flat_locations, flat_ray, flat_tri = flat.intersects_location(*rays)
    counts, flat_counts = (np.bincount(each, minlength=len(rays[0])) for each in (index_ray, flat_ray))
    same = counts == flat_counts
    assert (~same).mean() <= MOST_DIFFERENT
    kept, flat_kept = same[index_ray], same[flat_ray]
    np.testing.assert_array_equal(index_ray[kept], flat_ray[flat_kept])
    np.testing.assert_allclose(locations[kept], flat_locations[flat_kept], atol=1e-5)
    assert (first_face[index_node[kept]] + index_tri[kept] != flat_tri[flat_kept]).mean() <= MOST_DIFFERENT


class TestContract:
    @pytest.mark.parametrize(
        "name", ["intersects_location", "intersects_id", "intersects_first", "intersects_any", "contains_points"]
    )
    def test_arguments_are_those_of_the_engine_of_a_mesh(self, name):
        ours, theirs = (inspect.signature(getattr(owner, name)) for owner in (SceneRay, RayMeshIntersector))
        assert [(p.name, p.default) for p in ours.parameters.values()] == [
            (p.name, p.default) for p in theirs.parameters.values()
        ]

    def test_hits_are_those_of_the_flattened_mesh(self, ray, rays):
        check_like_flattened(ray, rays)

    def test_names(self, ray):
        assert ray.nodes.tolist() == ["ring", "crate", "mirrored", "ball", "second ring"]
        assert ray.geometries.tolist() == ["torus", "box", "box", "ball", "torus"]
        before = ray.nodes
        ray.intersects_any([[0, 0, 0]], [[0, 0, 1]])
        np.testing.assert_array_equal(ray.nodes, before)

    def test_orders_and_dtypes(self, ray, rays):
        index_tri, index_ray, index_node, locations = ray.intersects_id(*rays, return_locations=True)
        assert {each.dtype for each in (index_tri, index_ray, index_node)} == {np.dtype(np.int64)}
        assert locations.dtype == np.float64
        depth = np.cumsum(np.concatenate(([0], np.diff(index_ray) <= 0)))
        t = ((locations - rays[0][index_ray]) * rays[1][index_ray]).sum(axis=1)
        order = np.lexsort((depth, index_ray))
        assert (np.diff(t[order])[np.diff(index_ray[order]) == 0] >= 0).all()
        again = ray.intersects_location(*rays)
        for array, expected in zip(again, (locations, index_ray, index_tri, index_node), strict=True):
            np.testing.assert_array_equal(array, expected)
        assert len(ray.intersects_id(*rays)) == 3
        for most in (1, 2):
            some = ray.intersects_id(*rays, max_hits=most)
            for array, expected in zip(some, (index_tri, index_ray, index_node), strict=True):
                np.testing.assert_array_equal(array, expected[depth < most])
        first = ray.intersects_first(*rays)
        assert [each.dtype for each in first] == [np.int32] * 2
        alone = ray.intersects_id(*rays, multiple_hits=False, return_locations=True)
        np.testing.assert_array_equal(alone[0], first[0][first[0] >= 0])
        np.testing.assert_array_equal(alone[2], first[1][first[1] >= 0])
        np.testing.assert_array_equal(alone[3], locations[depth < 1])

    @pytest.mark.parametrize("multiple_hits", [True, False])
    def test_no_rays_and_no_hits(self, ray, multiple_hits):
        for rays in ((np.empty((0, 3)), np.empty((0, 3))), ([[9, 9, 9]], [[1, 0, 0]]), ([[0, 0, 0]], [[0, 0, 0]])):
            found = ray.intersects_id(*rays, multiple_hits=multiple_hits, return_locations=True)
            assert [each.shape for each in found] == [(0,), (0,), (0,), (0, 3)]
            assert not ray.intersects_any(*rays).any()
        assert [len(each) for each in ray.intersects_id([[0, 0, 9]], [[0, 0, -1]], max_hits=0)] == [0, 0, 0]

    @pytest.mark.parametrize("seed", [3, 4])
    def test_contains_points(self, ray, scene, seed):
        points = np.random.default_rng(seed).uniform(-1.5, 2.5, (3000, 3))
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
        inside = np.array([RayMeshIntersector(part).contains_points(points) for part in parts])
        assert (inside.sum(axis=0) == 2).sum() > 10  # where parity of all crossings would be wrong
        np.testing.assert_array_equal(ray.contains_points(points), inside.any(axis=0))
        assert ray.contains_points(np.empty((0, 3))).shape == (0,)

    def test_an_open_mesh_contains_what_two_rays_agree_on(self, session):
        box = trimesh.creation.box()
        box.update_faces(np.arange(len(box.faces)) != 5)
        points = np.random.default_rng(5).uniform(-0.7, 0.7, (500, 3))
        expected = RayMeshIntersector(box).contains_points(points)
        # Their rays are the same, but for the mesh's own box, which the engine of a mesh looks at first.
        is_inside = SceneRay(trimesh.Scene(box), device=session.info.number).contains_points(points)
        np.testing.assert_array_equal(is_inside, expected)

    def test_bad_arguments(self, scene):
        with pytest.raises(SceneError, match=r"expected a trimesh.Scene, not Trimesh: for one mesh"):
            SceneRay(trimesh.creation.box())
        with pytest.raises(ConfigError, match="layout"):
            SceneRay(scene, layout="bvh3")
        with pytest.raises(QueryError, match="don't match"):
            SceneRay(scene).intersects_any([[0, 0, 0]], [[0, 0, 1]] * 2)
        with pytest.raises(QueryError, match=r"points must be \(n,3\)"):
            SceneRay(scene).contains_points([0, 0, 0])
        with pytest.raises(SceneError, match="no node with a triangle mesh"):
            SceneRay(trimesh.Scene()).intersects_any([[0, 0, 0]], [[0, 0, 1]])

    def test_copies(self, ray, rays):
        expected = ray.intersects_first(*rays)
        for other in (copy.copy(ray), copy.deepcopy(ray), pickle.loads(pickle.dumps(ray))):
            np.testing.assert_array_equal(other.intersects_first(*rays), expected)
            assert other.options == ray.options


class TestChanges:
    def test_a_node_that_moves_moves_all_below_it(self, ray, rays, work):
        ray.intersects_any(*rays)
        for step in range(3):
            ray.scene.graph.update("crate", matrix=TO([1 - step, 0.2 * step, 0.4]))
            check_like_flattened(ray, rays)
        assert work == ["Tracer", *["set_transforms"] * 3]

    def test_nothing_is_done_without_a_change(self, ray, rays, work):
        for _ in range(3):
            ray.intersects_any(*rays)
        assert work == ["Tracer"]

    def test_vertices_that_move(self, ray, rays, work):
        ray.intersects_any(*rays)
        torus = ray.scene.geometry["torus"]
        for _ in range(2):
            torus.vertices *= [1.1, 0.9, 1.2]
            check_like_flattened(ray, rays)
        assert work == ["Tracer", *["set_vertices"] * 2]

    def test_both_at_once(self, ray, rays, work):
        ray.intersects_any(*rays)
        ray.scene.geometry["box"].vertices *= 1.5
        ray.scene.graph.update("ball", matrix=TO([0, 0, 1]))
        check_like_flattened(ray, rays)
        assert work == ["Tracer", "set_transforms", "set_vertices"]

    @pytest.mark.parametrize("change", ["faces", "node", "geometry of a node", "delete", "base frame", "replaced"])
    def test_other_changes(self, ray, rays, work, change):
        ray.intersects_any(*rays)
        scene = ray.scene
        if change == "faces":
            scene.geometry["torus"].update_faces(np.arange(len(scene.geometry["torus"].faces)) % 3 > 0)
        elif change == "node":
            scene.graph.update("another", geometry="ball", matrix=TO([0, -1, 0]))
        elif change == "geometry of a node":
            scene.graph.update("crate", geometry="ball", matrix=TO([2.0, 0.3, 0]))
        elif change == "delete":
            scene.delete_geometry("ball")
        elif change == "base frame":
            scene.graph.base_frame = "crate"
        else:
            scene.geometry["box"] = trimesh.creation.icosphere(subdivisions=1)
        check_like_flattened(ray, rays)
        assert len(ray.nodes) == {"node": 6, "delete": 4}.get(change, 5)
        # Another base frame moves all nodes.
        assert work == ["Tracer", "set_transforms" if change == "base frame" else "Tracer"]

    def test_a_scene_that_goes_back(self, ray, rays):
        before = ray.intersects_first(*rays)
        torus = ray.scene.geometry["torus"]
        vertices = np.array(torus.vertices)
        for _ in range(2):
            torus.vertices = vertices * 1.3
            ray.scene.graph.update("crate", matrix=TO([0, 0, 0]))
            ray.intersects_any(*rays)
            torus.vertices = vertices
            ray.scene.graph.update("crate", matrix=TO([2.0, 0.3, 0]))
            np.testing.assert_array_equal(ray.intersects_first(*rays), before)

    def test_errors_name_the_node_and_pass(self, ray, rays):
        before = ray.intersects_first(*rays)
        ray.scene.graph.update("ball", matrix=np.diag([1.0, 0, 1, 1]))
        for _ in range(2):
            with pytest.raises(SceneError, match="the transform of the node 'ball' is singular"):
                ray.intersects_any(*rays)
        shear = np.eye(4)
        shear[0, 1], shear[:3, 3] = 0.5, [-2, 0.5, 0]
        ray.scene.graph.update("ball", matrix=shear)
        np.testing.assert_array_equal(ray.intersects_first(*rays), before)
        box = ray.scene.geometry["box"]
        vertices = np.array(box.vertices)
        box.vertices = np.where(np.arange(len(vertices))[:, None] == 3, np.nan, vertices)
        for _ in range(2):
            with pytest.raises(MeshError, match="vertex 3"):
                ray.intersects_any(*rays)
        box.vertices = vertices
        np.testing.assert_array_equal(ray.intersects_first(*rays), before)

    @pytest.mark.parametrize("is_done", [True, False])
    @pytest.mark.parametrize("change", ["set_transforms", "set_vertices"])
    def test_ctrl_c_in_a_change(self, ray, rays, monkeypatch, change, is_done):
        before, method = ray.intersects_first(*rays), getattr(Tracer, change)

        def interrupt(self, *arguments):
            if is_done:
                method(self, *arguments)
            raise KeyboardInterrupt

        monkeypatch.setattr(Tracer, change, interrupt)
        box, vertices = ray.scene.geometry["box"], np.array(ray.scene.geometry["box"].vertices)
        if change == "set_vertices":
            box.vertices = vertices * 2
        else:
            ray.scene.graph.update("crate", matrix=TO([0, 0, 0]))
        with pytest.raises(KeyboardInterrupt):
            ray.intersects_first(*rays)
        monkeypatch.undo()
        box.vertices = vertices
        ray.scene.graph.update("crate", matrix=TO([2.0, 0.3, 0]))
        np.testing.assert_array_equal(ray.intersects_first(*rays), before)

    def test_a_tracer_that_another_thread_closes(self, ray, rays):
        expected, is_over, answers = ray.intersects_first(*rays), threading.Event(), []

        def close():
            while not is_over.wait(0.01):
                ray.close()
                ray._tracer.give_way()

        closer = threading.Thread(target=close)
        closer.start()
        threads = [
            threading.Thread(target=lambda: answers.extend(ray.intersects_first(*rays) for _ in range(5)))
            for _ in range(3)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        is_over.set()
        closer.join()
        assert len(answers) == 15
        for answer in answers:
            np.testing.assert_array_equal(answer, expected)
