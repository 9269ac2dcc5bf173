"""The ray engine for trimesh: its contract, and that it follows a mesh that changes."""

import copy
import inspect
import pickle

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.errors import ConfigError, MeshError
from clbvh.integrations.trimesh import (
    ProximityQuery,
    RayMeshIntersector,
    install,
    is_installed,
    tracers,
)
from clbvh.trace.points.queries import GENERIC_DIRECTIONS

# Declared by the embree engine of trimesh 5.
SIGNATURES = {
    "intersects_location": "(ray_origins, ray_directions, multiple_hits=True)",
    "intersects_id": "(ray_origins, ray_directions, multiple_hits=True, max_hits=100, return_locations=False)",
    "intersects_first": "(ray_origins, ray_directions)",
    "intersects_any": "(ray_origins, ray_directions)",
    "contains_points": "(points)",
}


@pytest.fixture
def box(session):
    mesh = trimesh.creation.box()
    mesh.ray = RayMeshIntersector(mesh, device=session.info.number)
    yield mesh
    mesh.ray.close()


@pytest.fixture(scope="module")
def torus(_opened_device):
    mesh = trimesh.creation.torus(1.0, 0.3)
    mesh.ray = RayMeshIntersector(mesh, device=_opened_device.info.number)
    yield mesh
    mesh.ray.close()


@pytest.fixture(scope="module")
def rays():
    generator = np.random.default_rng(80)
    origins = generator.uniform(-2, 2, (5000, 3))
    return origins, (generator.uniform(-1, 1, (5000, 3)) - origins) * generator.uniform(0.01, 100, (5000, 1))


class TestContract:
    @pytest.mark.parametrize("name", SIGNATURES)
    def test_arguments_and_defaults(self, name):
        signature = inspect.signature(getattr(RayMeshIntersector, name))
        bare = [p.replace(annotation=inspect.Parameter.empty) for p in list(signature.parameters.values())[1:]]
        assert str(inspect.Signature(bare)) == SIGNATURES[name]

    def test_constructor(self):
        parameters = list(inspect.signature(RayMeshIntersector).parameters.values())
        assert [(p.name, p.default) for p in parameters[:2]] == [
            ("geometry", inspect.Parameter.empty),
            ("scale_to_box", True),
        ]
        assert all(p.kind is inspect.Parameter.KEYWORD_ONLY for p in parameters[2:])

    def test_orders_and_dtypes(self, box):
        # Two rays through the box, the middle one beside it: first hits first, each depth in the order of the rays.
        origins, directions = [[0.1, 0.2, 5], [9, 9, 9], [0.3, 0.1, -5]], [[0, 0, -2], [0, 0, -2], [0, 0, 0.5]]
        index_tri, index_ray, locations = box.ray.intersects_id(origins, directions, return_locations=True)
        assert index_ray.tolist() == [0, 2, 0, 2]
        np.testing.assert_allclose(
            locations, [[0.1, 0.2, 0.5], [0.3, 0.1, -0.5], [0.1, 0.2, -0.5], [0.3, 0.1, 0.5]], atol=1e-15
        )
        np.testing.assert_allclose(box.face_normals[index_tri][:, 2], [1, -1, -1, 1])
        for array, dtype in ((index_tri, np.int64), (index_ray, np.int64), (locations, np.float64)):
            assert array.dtype == dtype
        again = box.ray.intersects_location(origins, directions)
        for array, expected in zip(again, (locations, index_ray, index_tri), strict=True):
            np.testing.assert_array_equal(array, expected)
        assert len(box.ray.intersects_id(origins, directions)) == 2

        first = box.ray.intersects_first(origins, directions)
        assert first.dtype == np.int32
        assert first.tolist() == [index_tri[0], -1, index_tri[1]]
        any_hit = box.ray.intersects_any(origins, directions)
        assert any_hit.dtype == bool
        assert any_hit.tolist() == [True, False, True]

    def test_first_hits_only(self, torus, rays):
        index_tri, index_ray, locations = torus.ray.intersects_id(*rays, multiple_hits=False, return_locations=True)
        first = torus.ray.intersects_first(*rays)
        np.testing.assert_array_equal(index_ray, np.flatnonzero(first >= 0))
        np.testing.assert_array_equal(index_tri, first[index_ray])
        without = torus.ray.intersects_id(*rays, multiple_hits=False)
        np.testing.assert_array_equal(without[0], index_tri)
        np.testing.assert_array_equal(without[1], index_ray)
        assert all(array.dtype == np.int64 for array in without)
        np.testing.assert_array_equal(torus.ray.intersects_any(*rays), first >= 0)
        along = rays[1][index_ray] / np.linalg.norm(rays[1][index_ray], axis=1)[:, None]
        assert np.abs(np.cross(locations - rays[0][index_ray], along)).max() < 1e-6
        every = torus.ray.intersects_location(*rays)
        for array, expected in zip(every, (locations, index_ray, index_tri), strict=True):
            np.testing.assert_array_equal(array[: len(expected)], expected)

    def test_every_hit_of_every_ray(self, torus, rays):
        locations, index_ray, index_tri = torus.ray.intersects_location(*rays)
        counts = np.bincount(index_ray, minlength=len(rays[0]))
        assert counts.max() == 4
        # A ray from outside goes in as often as out.
        outside = ~torus.ray.contains_points(rays[0])
        np.testing.assert_array_equal(counts % 2, ~outside)
        assert (~outside).sum() > 50
        # Each depth in the order of the rays, and depths after one another along each ray.
        depth = np.cumsum(np.concatenate(([0], np.diff(index_ray) <= 0)))
        assert depth.max() == 3
        t = ((locations - rays[0][index_ray]) * rays[1][index_ray]).sum(axis=1)
        order = np.lexsort((depth, index_ray))
        assert (np.diff(t[order])[np.diff(index_ray[order]) == 0] > 0).all()
        assert len(np.unique(np.stack((index_ray, index_tri)), axis=1).T) == len(index_ray)

    @pytest.mark.parametrize("most", [1, 2, 3])
    def test_max_hits(self, torus, rays, most):
        every = torus.ray.intersects_id(*rays)
        counts = np.bincount(every[1], minlength=len(rays[0]))
        limited = torus.ray.intersects_id(*rays, max_hits=most)
        assert len(limited[0]) == np.minimum(counts, most).sum()
        for array, expected in zip(limited, every, strict=True):
            np.testing.assert_array_equal(array, expected[: len(array)])

    def test_no_hits_at_all(self, box):
        nothing = np.empty((0, 3))
        for origins, directions in ((nothing, nothing), ([[9, 9, 9]], [[1, 0, 0]])):
            for more in ({}, {"multiple_hits": False}, {"max_hits": 0}):
                arrays = box.ray.intersects_id(origins, directions, return_locations=True, **more)
                assert [(array.shape, array.dtype) for array in arrays] == [((0,), int), ((0,), int), ((0, 3), float)]
                arrays = box.ray.intersects_id(origins, directions, **more)
                assert [(array.shape, array.dtype) for array in arrays] == [((0,), int), ((0,), int)]
            arrays = box.ray.intersects_location(origins, directions)
            assert [(array.shape, array.dtype) for array in arrays] == [((0, 3), float), ((0,), int), ((0,), int)]
        assert box.ray.intersects_first(nothing, nothing).shape == (0,)
        assert box.ray.intersects_any(nothing, nothing).shape == (0,)
        assert box.ray.contains_points(nothing).shape == (0,)

    def test_inputs_are_left_alone(self, torus, rays):
        given = [array.copy() for array in rays]
        for array in given:
            array.flags.writeable = False
        for query in ("intersects_location", "intersects_id", "intersects_first", "intersects_any"):
            getattr(torus.ray, query)(*given)
        torus.ray.contains_points(given[0])
        for array, before in zip(given, rays, strict=True):
            np.testing.assert_array_equal(array, before)

    def test_lists_float32_and_integers(self, box):
        for dtype in (list, np.float32, np.int64, np.float16):
            origins, directions = [[0, 0, 5]], [[0, 0, -3]]
            if dtype is not list:
                origins, directions = np.array(origins, dtype), np.array(directions, dtype)
            assert len(box.ray.intersects_location(origins, directions)[0]) == 2

    def test_rays_that_are_none_hit_nothing(self, box):
        origins = np.array([[0, 0, 5], [np.nan, 0, 5], [0, 0, 5], [0, np.inf, 0], [0, 0, 5]], float)
        directions = np.array([[0, 0, -1], [0, 0, -1], [0, 0, 0], [0, -1, 0], [0, -np.inf, 0]], float)
        expected = [True, False, False, False, False]
        assert box.ray.intersects_any(origins, directions).tolist() == expected
        assert (box.ray.intersects_first(origins, directions) >= 0).tolist() == expected
        assert box.ray.intersects_id(origins, directions)[1].tolist() == [0, 0]
        assert box.ray.intersects_location(origins, directions, multiple_hits=False)[1].tolist() == [0]
        assert np.isnan(origins[1, 0])

    def test_wrong_shapes(self, box):
        for query in (box.ray.intersects_id, box.ray.intersects_first, box.ray.intersects_any):
            with pytest.raises(ValueError, match="Ray origin and direction don't match!"):
                query([[0, 0, 0]], [[0, 0, 1]] * 2)
            with pytest.raises(ValueError, match="shape"):
                query([0, 0, 5], [0, 0, -1])
        with pytest.raises(ValueError, match=r"points must be \(n,3\)"):
            box.ray.contains_points([0, 0, 0])


class TestOutlines:
    def test_rays_along_the_outline_of_a_box_hit(self, box):
        sides = np.array([[x, y, 5] for x in (-0.5, 0, 0.5) for y in (-0.5, 0, 0.5)])
        down = np.tile([0.0, 0.0, -1.0], (9, 1))
        assert box.ray.intersects_any(sides, down).all()
        counts = np.bincount(box.ray.intersects_id(sides, down)[1], minlength=9)
        np.testing.assert_array_equal(counts, 2)

    def test_from_the_middle_through_every_vertex_there_is_one_hit(self, torus):
        mesh = trimesh.creation.box(extents=[40, 40, 40]).subdivide_to_size(20)
        mesh.ray = RayMeshIntersector(mesh)
        outer = trimesh.creation.box(extents=[60, 60, 60]).subdivide_to_size(20)
        _, index_ray = mesh.ray.intersects_id(np.zeros_like(outer.vertices), outer.vertices)
        np.testing.assert_array_equal(index_ray, np.arange(len(outer.vertices)))

    @pytest.mark.parametrize("scale", [1e-6, 1e-4, 1.0, 1e4, 1e8])
    def test_from_on_the_surface_through_the_box_there_are_two_hits(self, session, scale):
        mesh = trimesh.creation.box().subdivide().subdivide()
        mesh.apply_scale(scale)
        mesh.ray = RayMeshIntersector(mesh)
        index_tri, _ = mesh.ray.intersects_id([[0, 0, scale / 2]], [[0, 0, -1]])
        assert len(index_tri) == 2


class TestContains:
    def test_a_torus(self, torus):
        points = np.random.default_rng(81).uniform(-1.4, 1.4, (20_000, 3)) * [1, 1, 0.3]
        ring = np.hypot(points[:, 0], points[:, 1]) - 1
        radius = np.hypot(ring, points[:, 2])
        sure = (radius < 0.28) | (radius > 0.31)  # the facets' share
        contains = torus.ray.contains_points(points)
        assert contains.dtype == bool
        np.testing.assert_array_equal(contains[sure], (radius < 0.3)[sure])
        np.testing.assert_array_equal(torus.contains(points), contains)

    def test_a_hollow_is_outside(self, session):
        outer, inner = trimesh.creation.box(), trimesh.creation.box(extents=[0.2] * 3)
        inner.invert()
        mesh = trimesh.util.concatenate([outer, inner])
        mesh.ray = RayMeshIntersector(mesh)
        assert mesh.ray.contains_points([[0, 0, 0], [0.3, 0.2, 0.1], [2, 0, 0]]).tolist() == [False, True, False]

    def test_where_there_and_back_disagree_another_direction_decides(self, session):
        point = 3 * GENERIC_DIRECTIONS[0]
        across = np.linalg.svd(point[None])[2][1:]
        stray = trimesh.Trimesh(point + 0.5 * np.array([across[0], across[1], -across[0] - across[1]]), [[0, 1, 2]])
        mesh = trimesh.util.concatenate([trimesh.creation.box(), stray])
        mesh.ray = RayMeshIntersector(mesh)
        assert mesh.ray.intersects_id([[0, 0, 0]], [point])[1].tolist() == [0, 0]
        assert mesh.ray.contains_points([[0, 0, 0]])[0]

    def test_through_a_hole_points_get_outside(self, session):
        mesh = trimesh.creation.icosphere()
        mesh.update_faces(np.arange(len(mesh.faces)) % 50 != 0)
        mesh.ray = RayMeshIntersector(mesh)
        points = np.random.default_rng(82).uniform(-1, 1, (4000, 3))
        radius = np.linalg.norm(points, axis=1)
        contains = mesh.ray.contains_points(points)
        assert 0.9 < contains[radius < 0.9].mean() < 1
        assert not contains[radius > 1].any()


class TestTheRestOfTrimesh:
    """Functions of trimesh that cast rays use the engine."""

    def test_longest_rays(self, torus):
        length = trimesh.proximity.longest_ray(torus, [[1.0, 0, 0]], [[0, 0, 1.0]])
        assert length[0] == pytest.approx(0.3, rel=1e-2)


class TestChanges:
    def test_a_mesh_that_moves_is_refitted(self, box, monkeypatch):
        ray = [[0.1, 0.2, 5]], [[0, 0, -1]]
        assert box.ray.intersects_location(*ray)[0][0, 2] == pytest.approx(0.5)
        monkeypatch.setattr(tracers, "build", None)
        for lift in (1.0, -0.25):
            box.apply_translation([0, 0, lift])
            assert box.ray.intersects_location(*ray)[0][0, 2] == pytest.approx(box.bounds[1, 2])
        box.vertices[:, 2] *= 3.0
        assert box.ray.intersects_location(*ray)[0][0, 2] == pytest.approx(box.bounds[1, 2])

    def test_other_faces_are_built_again(self, box):
        rays = np.array([[0.1, 0.2, 5.0]]), np.array([[0, 0, -1.0]])
        assert len(box.ray.intersects_id(*rays)[0]) == 2
        box.update_faces(box.face_normals[:, 2] < 0.5)
        assert len(box.ray.intersects_id(*rays)[0]) == 1
        box.faces = box.faces[:, ::-1]
        assert len(box.ray.intersects_id(*rays)[0]) == 1

    def test_a_mesh_without_faces_is_an_error(self, session):
        with pytest.raises(MeshError):
            RayMeshIntersector(trimesh.Trimesh()).intersects_any([[0, 0, 5]], [[0, 0, -1]])

    def test_after_close_it_opens_again(self, box):
        for _ in range(2):
            assert box.ray.intersects_any([[0, 0, 5]], [[0, 0, -1]])[0]
            box.ray.close()


class TestOtherMeshes:
    @pytest.mark.parametrize("form", ["mesh", "arrays", "path", "text"])
    def test_what_people_have(self, session, tmp_path, form):
        box = trimesh.creation.box()
        arrays = np.array(box.vertices), np.array(box.faces)
        path = tmp_path / "box.ply"
        box.export(path)
        thing = {"mesh": clbvh.Mesh.from_arrays(*arrays), "arrays": arrays, "path": path, "text": str(path)}[form]
        engine = RayMeshIntersector(thing)
        index_tri, index_ray, locations = engine.intersects_id([[0.1, 0.2, 5]], [[0, 0, -2]], return_locations=True)
        assert index_ray.tolist() == [0, 0]
        np.testing.assert_allclose(locations, [[0.1, 0.2, 0.5], [0.1, 0.2, -0.5]], atol=1e-7)
        np.testing.assert_allclose(engine.mesh.face_normals[index_tri][:, 2], [1, -1])
        assert engine.contains_points([[0, 0, 0], [2, 0, 0]]).tolist() == [True, False]
        engine.close()

    def test_faces_keep_their_numbers(self, session):
        vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]]
        engine = RayMeshIntersector((vertices, [[0, 1, 2], [0, 0, 1], [4, 5, 6]]))
        assert engine.intersects_first([[0.2, 0.2, 5], [0.2, 0.2, -5]], [[0, 0, -1], [0, 0, 1]]).tolist() == [2, 0]

    @pytest.mark.parametrize("wrong", [None, 7, [], (1, 2, 3), np.zeros((3, 3))])
    def test_what_is_no_mesh(self, wrong):
        with pytest.raises(MeshError):
            RayMeshIntersector(wrong)

    @pytest.mark.parametrize("make", [RayMeshIntersector, ProximityQuery, lambda mesh, **more: install(**more)])
    @pytest.mark.parametrize("device", [[0], {}, 0.0, np.zeros(2)])
    def test_what_is_no_device(self, make, device):
        with pytest.raises(ConfigError, match=r"device must be a clbvh\.DeviceInfo, a number, a name or None, not "):
            make(trimesh.creation.box(), device=device)
        assert not is_installed()

    @pytest.mark.parametrize("layout", ["bvh3", [], None])
    def test_what_is_no_layout(self, layout):
        with pytest.raises(ConfigError, match="layout"):
            RayMeshIntersector(trimesh.creation.box(), layout=layout)

    def test_no_faces_contain_nothing(self):
        with pytest.raises(MeshError, match="a mesh without faces contains no points"):
            RayMeshIntersector(trimesh.Trimesh()).contains_points([[0, 0, 0]])


class TestCopies:
    def test_pickled(self, box):
        assert box.ray.intersects_any([[0, 0, 5]], [[0, 0, -1]])[0]
        loaded = pickle.loads(pickle.dumps(box.ray))
        assert loaded.intersects_any([[0, 0, 5]], [[0, 0, -1]])[0]
        assert loaded.mesh is not box

    def test_a_pickled_mesh_keeps_its_engine(self, box):
        assert box.ray.intersects_any([[0, 0, 5]], [[0, 0, -1]])[0]
        loaded = pickle.loads(pickle.dumps(box))
        assert isinstance(loaded.ray, RayMeshIntersector)
        loaded.apply_translation([10, 0, 0])
        assert loaded.ray.intersects_any([[10, 0, 5]], [[0, 0, -1]])[0]
        assert box.ray.intersects_any([[0, 0, 5]], [[0, 0, -1]])[0]

    @pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy])
    def test_copied(self, box, duplicate):
        assert box.ray.intersects_any([[0, 0, 5]], [[0, 0, -1]])[0]
        other = duplicate(box.ray)
        assert other.mesh is box
        assert other.intersects_any([[0, 0, 5]], [[0, 0, -1]])[0]
        other.close()
        assert box.ray.intersects_any([[0, 0, 5]], [[0, 0, -1]])[0]


class TestRepr:
    def test_it_names_device_and_layout(self, session, box):
        assert "layout='auto'" in repr(RayMeshIntersector(trimesh.creation.box()))
        box.ray.intersects_any([[0, 0, 5]], [[0, 0, -1]])
        text = repr(box.ray)
        assert session.info.name in text
        assert f"layout={session.info.layout!r}" in text

    def test_without_the_device_too(self):
        assert "no such board" in repr(RayMeshIntersector(trimesh.creation.box(), device="no such board"))
