"""The engine as the default of every mesh: what `install` changes, and that `uninstall` leaves nothing behind."""

import copy
import gc
import pickle
import threading
from weakref import ref

import numpy as np
import pytest
import trimesh

from clbvh.integrations import trimesh as engine
from clbvh.integrations.trimesh import ProximityQuery, RayMeshIntersector, tracers
from clbvh.integrations.trimesh.tracers import open_tracers

from ..concurrency.threads import run_in_threads

RAY = [[0.1, 0.2, 5]], [[0, 0, -1]]
PATCHED = ("closest_point", "signed_distance", "longest_ray", "max_tangent_sphere", "thickness")


def state():
    """All that `install` may change in trimesh."""
    # Pickling a mesh adds `__slotnames__` to its class.
    of_class = {name: value for name, value in vars(trimesh.Trimesh).items() if name != "__slotnames__"}
    return of_class, dict(vars(trimesh.proximity)), dict(vars(trimesh.ray))


@pytest.fixture(autouse=True)
def _nothing_is_left(session):
    before = state()
    yield
    engine.uninstall()
    assert state() == before


@pytest.fixture
def box():
    return trimesh.creation.box()


def is_ours(mesh):
    ray, nearest = isinstance(mesh.ray, RayMeshIntersector), isinstance(mesh.nearest, ProximityQuery)
    assert ray == nearest
    return ray


class TestEveryMesh:
    def test_whenever_and_however_it_was_made(self, box):
        engine.install()
        box.ray.intersects_any(*RAY)
        pickled = pickle.dumps(box)
        others = [
            trimesh.creation.box(), box.copy(), copy.copy(box), copy.deepcopy(box), box.copy(include_cache=True),
            pickle.loads(pickled), box.subdivide(), box.submesh([range(12)], append=True),
            trimesh.util.concatenate([box, box]), trimesh.Scene(box).to_mesh(), trimesh.primitives.Box().copy(),
            trimesh.primitives.Sphere(), trimesh.Trimesh(box.vertices, box.faces, use_embree=False),
        ]  # fmt: skip
        for mesh in (box, *others):
            assert is_ours(mesh)
            assert mesh.ray.mesh is mesh
            assert mesh.ray.intersects_any(*RAY)[0]
        assert box.contains([[0, 0, 0]])[0]
        engine.uninstall()
        assert not any(map(is_ours, (box, *others)))
        # As in a process that is spawned: nothing of the engine is in a pickle, but for one that was assigned by hand.
        assert not is_ours(pickle.loads(pickled))
        box.ray, box.nearest = RayMeshIntersector(box), ProximityQuery(box)
        assert is_ours(pickle.loads(pickle.dumps(box)))


class TestByHand:
    def test_other_engines_stay(self, box):
        class Custom:
            pass

        box.ray, box.nearest = custom = Custom(), Custom()
        engine.install()
        assert (box.ray, box.nearest) == custom
        box.ray = again = Custom()
        assert box.ray is again

    def test_trimeshs_engines_assigned_meanwhile_stay(self, box):
        engine.install()
        box.ray = theirs = trimesh.ray.ray_triangle.RayMeshIntersector(box)
        assert box.ray is theirs

    def test_functions_replaced_by_others_stay(self, monkeypatch):
        original = trimesh.proximity.thickness
        engine.install()
        trimesh.proximity.thickness = print
        engine.uninstall()
        assert trimesh.proximity.thickness is print
        trimesh.proximity.thickness = original


class TestStates:
    def test_twice_is_once_and_functions_are_replaced(self, box):
        before = state()
        for _ in range(3):
            engine.install()
        assert engine.is_installed()
        for name in PATCHED:
            assert getattr(trimesh.proximity, name) is getattr(engine, name)
        point = np.zeros((1, 3), np.float32)
        assert trimesh.proximity.signed_distance(box, point)[0] == pytest.approx(0.5)
        for _ in range(2):
            engine.uninstall()
            assert state() == before
            assert not engine.is_installed()

    def test_blocks_restore_what_was_before_with_its_options(self, box):
        with engine.install(layout="bvh4"):
            with engine.install(layout="bvh2"):
                assert "bvh2" in repr(box.ray)
            assert "bvh4" in repr(box.ray)
        assert not engine.is_installed()
        with pytest.raises(ZeroDivisionError), engine.install():
            1 / 0  # noqa: B018
        assert not is_ours(box)

    def test_threads_install_uninstall_and_cast_at_once(self):
        """No error, no wrong answer, and nothing left."""
        end = threading.Event()

        def toggle():
            while not end.is_set():
                with engine.install():
                    pass
                engine.install()
                engine.uninstall()

        def cast():
            try:
                for _ in range(20):
                    mesh = trimesh.creation.box()
                    mesh.ray = RayMeshIntersector(mesh)
                    assert mesh.copy().vertices.shape == (8, 3)
                    assert mesh.contains([[0, 0, 0], [2, 0, 0]]).tolist() == [True, False]
                    assert engine.signed_distance(mesh, [[0, 0, 0]])[0] == pytest.approx(0.5)
            finally:
                end.set()

        run_in_threads(*[toggle] * 3, *[cast] * 3)


class TestMemory:
    @pytest.fixture(autouse=True)
    def _only_the_meshes_of_the_test_have_a_tracer(self):
        gc.collect()
        for tracer in open_tracers():
            tracer.close()

    def test_meshes_that_are_gone_hold_nothing(self, monkeypatch):
        """Without a collection by hand, and with none by Python."""
        monkeypatch.setattr(tracers, "_TREES_PER_COLLECTION", 5)
        engine.install()
        gc.disable()
        try:
            for size in range(1, 20):  # some at the address of another one
                mesh = trimesh.creation.box(extents=[size] * 3)
                assert mesh.nearest.on_surface([[0, 0, 0]])[1][0] == pytest.approx(size / 2)
                assert len(open_tracers()) <= 5 + 1
        finally:
            gc.enable()
        session = ref(mesh.ray._tracer.open_tracer._caster.session)
        del mesh
        gc.collect()
        assert (session(), open_tracers(), dict(tracers.kept)) == (None, {}, {})

    def test_a_full_device_loses_the_trees_that_were_not_used_for_longest(self, monkeypatch, session):
        engine.install()
        meshes = [trimesh.creation.icosphere(2) for _ in range(7)]
        meshes[0].ray.intersects_any(*RAY)
        (first,) = open_tracers()
        limit = 6.5 * first.open_tracer.memory_bytes
        monkeypatch.setattr(tracers, "_MEMORY_SHARE", limit / session.info.memory_bytes)
        for mesh in meshes:
            assert mesh.contains([[0, 0, 0]])[0]
            assert sum(tracer.open_tracer.memory_bytes for tracer in open_tracers()) <= limit
        assert open_tracers().keys() == {mesh.ray._tracer for mesh in meshes[-3:]}
        # Nothing is built again.
        monkeypatch.setattr(tracers, "build", None)
        assert meshes[0].contains([[0, 0, 0]])[0]

    def test_uninstall_gives_the_memory_back(self, box):
        engine.install()
        assert box.contains([[0, 0, 0]])[0]
        assert len(open_tracers()) == 1
        engine.uninstall()
        gc.collect()
        assert open_tracers() == {}
