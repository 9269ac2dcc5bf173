"""The ray engine of a scene of trimesh: against its flattened mesh, and that it follows a scene that changes."""

import copy
import pickle

import numpy as np
import pytest
import trimesh

from clbvh import Scene, SceneError, Tracer
from clbvh.integrations.trimesh import RayMeshIntersector, SceneRay, tracers

from .test_trimesh_ray import check_same

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
    return SceneRay(scene, device=session.info.number)


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
    def test_nodes_have_the_names_of_now(self, ray, rays):
        for _ in range(2):
            assert ray.nodes.tolist() == ["ring", "crate", "mirrored", "ball", "second ring"]
            assert ray.geometries.tolist() == ["torus", "box", "box", "ball", "torus"]
            ray.intersects_any(*rays)
        ray.scene.delete_geometry("ball")
        assert ray.nodes.tolist() == ["ring", "crate", "mirrored", "second ring"]

    def test_orders_and_dtypes(self, ray, rays):
        index_tri, index_ray, index_node, locations = ray.intersects_id(*rays, return_locations=True)
        assert [each.dtype for each in (index_tri, index_ray, index_node, locations)] == [np.int64] * 3 + [np.float64]
        depth = np.cumsum(np.concatenate(([0], np.diff(index_ray) <= 0)))
        t = ((locations - rays[0][index_ray]) * rays[1][index_ray]).sum(axis=1)
        order = np.lexsort((depth, index_ray))
        assert (np.diff(t[order])[np.diff(index_ray[order]) == 0] >= 0).all()
        check_same(ray.intersects_location(*rays), (locations, index_ray, index_tri, index_node))
        for most in (1, 2):
            some = (each[depth < most] for each in (index_tri, index_ray, index_node))
            check_same(ray.intersects_id(*rays, max_hits=most), some)
        first = ray.intersects_first(*rays)
        assert [each.dtype for each in first] == [np.int32] * 2
        alone = ray.intersects_id(*rays, multiple_hits=False, return_locations=True)
        is_hit = first[0] >= 0
        check_same(alone, (first[0][is_hit], np.flatnonzero(is_hit), first[1][is_hit], locations[depth < 1]))

    def test_no_rays_and_no_hits(self, ray):
        for rays in ((np.empty((0, 3)), np.empty((0, 3))), ([[9, 9, 9]], [[1, 0, 0]]), ([[0, 0, 0]], [[0, 0, 0]])):
            for more in ({}, {"multiple_hits": False}, {"max_hits": 0}):
                found = ray.intersects_id(*rays, return_locations=True, **more)
                assert [each.shape for each in found] == [(0,), (0,), (0,), (0, 3)]

    def test_contains_points(self, ray, scene):
        points = np.random.default_rng(3).uniform(-1.5, 2.5, (3000, 3))
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
        inside = np.array([RayMeshIntersector(part).contains_points(points) for part in parts])
        assert (inside.sum(axis=0) == 2).sum() > 10  # where parity of all crossings would be wrong
        np.testing.assert_array_equal(ray.contains_points(points), inside.any(axis=0))
        assert ray.contains_points(np.empty((0, 3))).shape == (0,)

    def test_copies(self, ray, rays):
        expected = ray.intersects_first(*rays)
        for other in (copy.copy(ray), copy.deepcopy(ray), pickle.loads(pickle.dumps(ray))):
            check_same(other.intersects_first(*rays), expected)
            assert other.options == ray.options


class TestChanges:
    def test_nodes_and_vertices_that_move_are_followed(self, ray, rays, work):
        ray.intersects_any(*rays)
        for step in range(2):  # a node moves all below it
            ray.scene.graph.update("crate", matrix=TO([1 - step, 0.2 * step, 0.4]))
            check_like_flattened(ray, rays)
            ray.intersects_any(*rays)
        for _ in range(2):
            ray.scene.geometry["torus"].vertices *= [1.1, 0.9, 1.2]
            check_like_flattened(ray, rays)
        ray.scene.geometry["box"].vertices *= 1.5
        ray.scene.graph.update("ball", matrix=TO([0, 0, 1]))
        check_like_flattened(ray, rays)
        moved, deformed = ["set_transforms"], ["set_vertices"]
        assert work == ["Tracer", *moved * 2, *deformed * 2, *moved, *deformed]

    def test_other_changes(self, ray, rays, work):
        scene = ray.scene
        torus = scene.geometry["torus"]
        changes = {
            "faces": lambda: torus.update_faces(np.arange(len(torus.faces)) % 3 > 0),
            "geometry of a node": lambda: scene.graph.update("crate", geometry="ball", matrix=TO([2.0, 0.3, 0])),
            "base frame": lambda: setattr(scene.graph, "base_frame", "crate"),
            "replaced": lambda: scene.geometry.update(box=trimesh.creation.icosphere(subdivisions=1)),
            "another node": lambda: scene.graph.update("another", geometry="ball", matrix=TO([0, -1, 0])),
            "deleted": lambda: scene.delete_geometry("torus"),
        }
        ray.intersects_any(*rays)
        for name, change in changes.items():
            work.clear()
            change()
            check_like_flattened(ray, rays)
            # Another base frame moves all nodes.
            assert work == ["set_transforms" if name == "base frame" else "Tracer"], name

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
            check_same(ray.intersects_first(*rays), before)

    def test_an_error_names_the_node_and_passes(self, ray, rays):
        before, graph = ray.intersects_first(*rays), ray.scene.graph
        place = np.array(graph["ball"][0])
        graph.update("ball", matrix=TO([0, np.inf, 0]))
        for _ in range(2):
            with pytest.raises(SceneError, match="the transform of the node 'ball' must be finite"):
                ray.intersects_any(*rays)
        graph.update("ball", matrix=place)
        check_same(ray.intersects_first(*rays), before)

    def test_nodes_that_a_scale_of_0_hides_come_and_go(self, ray, rays):
        graph, shown = ray.scene.graph, ray.nodes
        index_tri, index_node = ray.intersects_first(*rays)
        places = {node: np.array(graph[node][0]) for node in shown}
        graph.update("ball", matrix=places["ball"] @ np.diag([1.0, 0, 1, 1]))
        assert ray.nodes.tolist() == [node for node in shown if node != "ball"]
        without = ray.intersects_first(*rays)[1]
        is_kept = (index_node >= 0) & (shown[index_node] != "ball")
        assert (shown[index_node[is_kept]] == ray.nodes[without[is_kept]]).all()
        # All of them, also what is below a hidden node.
        for node in ("ring", "crate", "second ring"):
            graph.update(node, matrix=np.diag([0.0, 0, 0, 1]))
        assert len(ray.nodes) == 0
        assert not ray.intersects_any(*rays).any()
        assert not ray.contains_points(rays[0]).any()
        for node in ("ring", "crate", "ball", "second ring"):
            graph.update(node, matrix=places[node])
        check_same(ray.intersects_first(*rays), (index_tri, index_node))
