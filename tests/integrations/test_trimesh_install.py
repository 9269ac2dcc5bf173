"""The engine as the default of every mesh: what `install` changes, and that `uninstall` leaves nothing behind."""

import copy
import gc
import json
import pickle
import subprocess
import sys
import threading
from weakref import ref

import numpy as np
import pytest
import trimesh

from clbvh.errors import ConfigError, DeviceError
from clbvh.integrations import trimesh as engine
from clbvh.integrations.trimesh import ProximityQuery, RayMeshIntersector, tracers
from clbvh.integrations.trimesh.tracers import open_tracers

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
    answers = isinstance(mesh.ray, RayMeshIntersector), isinstance(mesh.nearest, ProximityQuery)
    assert answers[0] == answers[1]
    return answers[0]


class TestEveryMesh:
    def test_whenever_it_was_made(self, box):
        engine.install()
        later = trimesh.creation.box()
        for mesh in (box, later):
            assert is_ours(mesh)
            assert mesh.ray.intersects_any(*RAY)[0]
            assert mesh.contains([[0, 0, 0]])[0]
        engine.uninstall()
        assert not is_ours(box)
        assert not is_ours(later)

    @pytest.mark.parametrize(
        "duplicate",
        [
            trimesh.Trimesh.copy,
            copy.copy,
            copy.deepcopy,
            lambda mesh: mesh.copy(include_cache=True),
            lambda mesh: pickle.loads(pickle.dumps(mesh)),
            lambda mesh: mesh.subdivide(),
            lambda mesh: mesh.submesh([range(12)], append=True),
            lambda mesh: trimesh.util.concatenate([mesh, mesh]),
            lambda mesh: trimesh.Scene(mesh).to_geometry() if hasattr(trimesh.Scene, "to_geometry") else mesh.copy(),
            lambda mesh: trimesh.primitives.Box().copy(),
            lambda mesh: trimesh.primitives.Sphere(),
        ],
    )
    def test_meshes_made_of_it(self, box, duplicate):
        engine.install()
        box.ray.intersects_any(*RAY)
        other = duplicate(box)
        assert is_ours(other)
        assert other.ray.mesh is other
        assert other.ray.intersects_any(*RAY)[0]

    def test_a_copy_and_its_original_change_apart(self, box):
        engine.install()
        assert box.ray.intersects_any(*RAY)[0]
        other = box.copy().apply_translation([10, 0, 0])
        assert not other.ray.intersects_any(*RAY)[0]
        assert box.ray.intersects_any(*RAY)[0]
        assert box.nearest.on_surface([[0, 0, 2]])[1] == pytest.approx(1.5)
        assert other.nearest.on_surface([[10, 0, 3]])[1] == pytest.approx(2.5)

    def test_a_mesh_without_embree(self):
        engine.install()
        assert is_ours(trimesh.Trimesh(use_embree=False))

    def test_a_mesh_that_changes_is_followed(self, box):
        engine.install()
        for lift in (0.0, 1.0, -3.0):
            box.apply_translation([0, 0, lift])
            assert box.ray.intersects_location(*RAY)[0][0, 2] == pytest.approx(box.bounds[1, 2])

    def test_nothing_is_built_twice(self, box, monkeypatch):
        built, build = [], tracers.build
        monkeypatch.setattr(tracers, "build", lambda *a, **k: built.append(a) or build(*a, **k))
        engine.install()
        for _ in range(3):
            box.ray.intersects_any(*RAY)
            box.contains([[0, 0, 0]])
            box.nearest.on_surface([[0, 0, 2]])
            box.nearest.vertex([[0, 0, 2]])
            trimesh.proximity.thickness(box, [[0, 0, 0.5]])
        assert len(built) == 1


class TestByHand:
    def test_other_engines_stay(self, box):
        class Custom:
            pass

        box.ray = custom = Custom()
        box.nearest = other = Custom()
        engine.install()
        assert box.ray is custom
        assert box.nearest is other
        box.ray = again = Custom()
        assert box.ray is again

    def test_our_own_stay_with_their_options(self, box):
        box.ray = own = RayMeshIntersector(box, layout="bvh2")
        engine.install(layout="bvh4")
        assert box.ray is own
        assert "layout='bvh2'" in repr(box.nearest)

    def test_trimeshs_engines_assigned_meanwhile_stay(self, box):
        engine.install()
        box.ray = theirs = trimesh.ray.ray_triangle.RayMeshIntersector(box)
        box.nearest = other = trimesh.proximity.ProximityQuery(box)
        assert box.ray is theirs
        assert box.nearest is other

    def test_deleted(self, box):
        engine.install()
        del box.ray
        for _ in range(2):
            with pytest.raises(AttributeError, match="'Trimesh' object has no attribute 'ray'"):
                _ = box.ray
            with pytest.raises(AttributeError):
                del box.ray
        box.ray = trimesh.ray.ray_triangle.RayMeshIntersector(box)
        assert isinstance(box.ray, RayMeshIntersector)

    def test_functions_replaced_by_others_stay(self):
        original = trimesh.proximity.thickness
        engine.install()
        trimesh.proximity.thickness = print
        engine.uninstall()
        assert trimesh.proximity.thickness is print
        trimesh.proximity.thickness = original


class TestStates:
    def test_twice_is_once(self, box):
        before = state()
        for _ in range(3):
            engine.install()
        assert engine.is_installed()
        engine.uninstall()
        assert state() == before
        engine.uninstall()
        assert not engine.is_installed()

    def test_functions_are_replaced(self):
        before = {name: getattr(trimesh.proximity, name) for name in PATCHED}
        engine.install()
        for name in PATCHED:
            assert getattr(trimesh.proximity, name) is getattr(engine, name)
        engine.uninstall()
        assert {name: getattr(trimesh.proximity, name) for name in PATCHED} == before

    def test_blocks(self, box):
        with engine.install():
            assert is_ours(box)
            with engine.install(layout="bvh2"):
                assert "bvh2" in repr(box.ray)
            assert engine.is_installed()
            assert "bvh2" not in repr(box.ray)
        assert not engine.is_installed()

    def test_after_an_error_in_a_block(self, box):
        with pytest.raises(ZeroDivisionError), engine.install():
            1 / 0  # noqa: B018
        assert not is_ours(box)

    def test_a_block_inside_leaves_the_outer_one(self):
        engine.install(layout="bvh4")
        with engine.install(layout="bvh2"):
            pass
        assert "bvh4" in repr(trimesh.creation.box().ray)

    def test_other_options(self, box):
        engine.install(layout="bvh2")
        assert box.ray.intersects_any(*RAY)[0]
        assert box.ray._tracer.open_tracer.layout == "bvh2"
        engine.install(layout="bvh4")
        assert box.ray.intersects_any(*RAY)[0]
        assert box.ray._tracer.open_tracer.layout == "bvh4"

    def test_an_unknown_layout(self):
        with pytest.raises(ConfigError, match="layout must be one of"):
            engine.install(layout="bvh3")
        assert not engine.is_installed()

    def test_an_unknown_device_is_said_by_the_first_query(self, box):
        engine.install(device="no such board")
        with pytest.raises(DeviceError, match="no such board"):
            box.contains([[0, 0, 0]])

    def test_threads(self, session):
        """Installing, uninstalling and casting at once: no error, no wrong answer, and nothing left."""
        errors, end = [], threading.Event()

        def toggle():
            while not end.is_set():
                with engine.install():
                    pass
                engine.install()
                engine.uninstall()

        def cast():
            try:
                for _ in range(60):
                    mesh = trimesh.creation.box()
                    mesh.ray = RayMeshIntersector(mesh)
                    assert mesh.copy().vertices.shape == (8, 3)
                    assert mesh.contains([[0, 0, 0], [2, 0, 0]]).tolist() == [True, False]
                    assert engine.signed_distance(mesh, [[0, 0, 0]])[0] == pytest.approx(0.5)
            except BaseException as error:
                errors.append(error)

        togglers, casters = ([threading.Thread(target=task) for _ in range(3)] for task in (toggle, cast))
        for thread in togglers + casters:
            thread.start()
        for thread in casters:
            thread.join()
        end.set()
        for thread in togglers:
            thread.join()
        assert errors == []

    def test_threads_share_one_tracer(self, box):
        engine.install()
        found, start = [], threading.Barrier(6)

        def cast():
            start.wait()
            box.ray.intersects_any(*RAY)
            found.append(box.ray._tracer)

        threads = [threading.Thread(target=cast) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(set(found)) == 1


@pytest.fixture
def no_other_meshes():
    """Only the meshes of the test have a tracer."""
    gc.collect()
    for tracer in open_tracers():
        tracer.close()


@pytest.mark.usefixtures("no_other_meshes")
class TestMemory:
    def test_a_mesh_that_is_gone_holds_nothing(self):
        engine.install()
        mesh = trimesh.creation.box()
        mesh.ray.intersects_any(*RAY)
        mesh.nearest.on_surface([[0, 0, 2]])
        (tracer,) = open_tracers()
        session, alive = ref(tracer.open_tracer._caster.session), ref(mesh)
        del mesh, tracer
        gc.collect()
        assert alive() is None
        assert session() is None
        assert open_tracers() == {}
        assert dict(tracers.kept) == {}

    @pytest.mark.parametrize("use", ["install", "by hand", "functions"])
    def test_200_meshes_in_a_loop(self, use):
        """Without a collection by hand, and with none by Python."""
        if use == "install":
            engine.install()
        most = 0
        gc.disable()
        try:
            for _ in range(200):
                mesh = trimesh.creation.box()
                if use == "by hand":
                    mesh.ray = RayMeshIntersector(mesh)
                if use == "functions":
                    engine.closest_point(mesh, [[0, 0, 2]])
                else:
                    assert mesh.ray.intersects_any(*RAY)[0]
                most = max(most, len(open_tracers()))
        finally:
            gc.enable()
        assert 1 < most <= tracers._TREES_PER_COLLECTION + 1

    def test_trees_in_use_leave_a_full_device(self, monkeypatch, session):
        engine.install()
        meshes = [trimesh.creation.icosphere(2) for _ in range(8)]
        meshes[0].ray.intersects_any(*RAY)
        (first,) = open_tracers()
        size = first.open_tracer.memory_bytes
        monkeypatch.setattr(tracers, "_MEMORY_SHARE", 3.5 * size / session.info.memory_bytes)
        for mesh in meshes * 2:
            assert mesh.contains([[0, 0, 0]])[0]
            assert sum(tracer.open_tracer.memory_bytes for tracer in open_tracers()) <= 3.5 * size
        # Those that were used last are there, and nothing was built again.
        assert meshes[-1].ray._tracer in open_tracers()
        built = []
        monkeypatch.setattr(tracers, "build", lambda *a, **k: built.append(a))
        assert meshes[0].contains([[0, 0, 0]])[0]
        assert built == []

    def test_uninstall_gives_the_memory_back(self, box):
        engine.install()
        assert box.contains([[0, 0, 0]])[0]
        assert len(open_tracers()) == 1
        engine.uninstall()
        gc.collect()
        assert open_tracers() == {}

    def test_another_mesh_at_the_same_address(self):
        engine.install()
        for size in range(1, 40):
            mesh = trimesh.creation.box(extents=[size] * 3)
            assert mesh.nearest.on_surface([[0, 0, 0]])[1][0] == pytest.approx(size / 2)
            del mesh
            gc.collect()


class TestProcesses:
    @pytest.mark.parametrize("name", ["spawn", "fork before", "fork after", "forkserver"])
    def test_children(self, name):
        if name != "spawn" and sys.platform == "win32":
            pytest.skip("Windows does not fork")
        command = [
            sys.executable,
            "-W",
            "ignore::DeprecationWarning",
            "-m",
            "tests.integrations.installed_children",
            name,
        ]
        finished = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert finished.returncode == 0, finished.stderr
        answers = json.loads(finished.stdout)
        ours, theirs = ["RayMeshIntersector", "clbvh", True], "trimesh"
        if name == "fork after":
            assert answers[0] == "DeviceError"
            assert "forked" in answers[1]
        elif name == "fork before":
            assert answers == ours
        else:
            # A new process installs for itself; an engine that was assigned by hand comes along.
            assert answers["as loaded"][1] == theirs
            assert answers["by hand"] == ours
            assert answers["installed"] == ours


def test_inputs_as_numpy_have_them(box):
    with engine.install():
        assert trimesh.proximity.signed_distance(box, np.zeros((1, 3), np.float32))[0] == pytest.approx(0.5)
