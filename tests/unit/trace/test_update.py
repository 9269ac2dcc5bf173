"""A tracer whose mesh moves: the answers of a new tracer, the same buffers, and nothing half done."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh

from clbvh import DeviceMemoryError, MeshError, OpenMeshWarning, QueryError, Tracer, build, sah_cost
from clbvh.device import program
from clbvh.trace.world.refit import Refit
from clbvh.tree_layouts import TREE_LAYOUTS

from ...concurrency.queries import ask, make_queries
from ...deform import deform

# Answers about open meshes are compared as well.
pytestmark = pytest.mark.filterwarnings("ignore:.*not closed:clbvh.OpenMeshWarning")


@pytest.fixture(scope="module")
def bvh(mesh):
    return build(mesh)


def answers(tracer):
    return [ask(tracer, *query) for query in make_queries(tracer.mesh, (1, 300), 0)]


def answers_of_new(bvh, vertices, layout="auto"):
    with Tracer(bvh.refit(vertices), layout=layout) as tracer:
        return answers(tracer)


class TestAnswers:
    @pytest.mark.parametrize("layout", TREE_LAYOUTS)
    def test_they_are_those_of_a_new_tracer_whatever_the_size_and_place(self, bvh, mesh, layout):
        places = [(1, 0), (1e-149, 0), ([1, 1, 0], 0), (1e149, 0), ([1, 0, 0], 0), (1e-30, 1e-20), (0, 0), (1, 1e9)]
        with Tracer(bvh, layout=layout) as tracer:
            for frame, (unit, shift) in enumerate(places):
                vertices = deform(mesh, frame) * unit + shift
                tracer.update(vertices)
                assert (tracer.mesh.vertices == vertices).all()
                assert answers(tracer) == answers_of_new(bvh, vertices, layout)


class TestResults:
    def test_earlier_hits_keep_their_mesh_and_locations_and_the_caller_the_tree(self, bvh, mesh, rays):
        kept = (bvh.nodes, bvh.prim_ids, mesh.vertices, mesh.local_vertices)
        stored = [array.tobytes() for array in kept]
        with Tracer(bvh) as tracer:
            before, expected = tracer.closest_hit(*rays), tracer.closest_hit(*rays).locations.tobytes()
            tracer.update(deform(mesh, 1))
            after = tracer.closest_hit(*rays)
            assert before.mesh is mesh
            assert after.mesh is tracer.mesh is not mesh
            tracer.update(deform(mesh, 2))
            tracer.update(deform(mesh, 3))
            assert before.locations.tobytes() == expected
            assert after.mesh is not tracer.mesh
        assert [array.tobytes() for array in kept] == stored

    def test_the_growth_is_that_of_the_sah_cost_until_the_tree_is_built_anew(self, bvh, mesh):
        with Tracer(bvh, layout="bvh2") as tracer:
            assert tracer.sah_growth == 1.0
            tracer.update(mesh.vertices)
            assert tracer.sah_growth == 1.0
            noise = np.random.default_rng(6).normal(size=mesh.vertices.shape)
            moved = mesh.vertices + 0.01 * noise
            tracer.update(moved)
            assert tracer.sah_growth == pytest.approx(sah_cost(bvh.refit(moved)) / sah_cost(bvh), rel=1e-6)
            assert 1.01 < tracer.sah_growth < 1.3
            tracer.update(mesh.vertices[:, ::-1] * 2.0**70 + 2.0**70)
            assert tracer.sah_growth == pytest.approx(1.0, rel=1e-6)
            shuffled = np.random.default_rng(6).permutation(mesh.vertices)
            assert sah_cost(bvh.refit(shuffled)) > 5 * sah_cost(bvh)
            tracer.update(shuffled)
            assert tracer.sah_growth == 1.0
            expected = build(mesh.with_vertices(shuffled), quality="fast")
            assert tracer.bvh.nodes.tobytes() == expected.nodes.tobytes()
            assert answers(tracer) == answers_of_new(bvh, shuffled)
        with Tracer((np.zeros((3, 3)), [[0, 1, 2]])) as tracer:
            tracer.update(np.eye(3))
            tracer.update(np.zeros((3, 3)))
            assert tracer.sah_growth == 1.0

    @pytest.mark.filterwarnings("error")
    def test_a_mesh_that_tears_is_told(self):
        torn = trimesh.creation.icosphere(subdivisions=2).triangles.reshape(-1, 3)
        with Tracer((torn, np.arange(len(torn)).reshape(-1, 3))) as tracer:
            assert tracer.contains([[0.0, 0, 0]]).all()
            tracer.update(np.concatenate((torn[:3] * 1.5, torn[3:])))
            with pytest.warns(OpenMeshWarning):
                tracer.contains([[0.0, 0, 0]])


class TestResources:
    def test_buffers_and_kernels_are_kept(self, bvh, mesh, session, monkeypatch):
        sizes, compiled = [], []
        kind, allocate, compile_now = type(session), type(session).allocate, program._compile
        with Tracer(bvh, device=session.info) as tracer:
            once = tracer.memory_bytes
            tracer.closest_hit([[0, 0, 9]], [[0, 0, -1]])
            tracer.update(deform(mesh, 0))
            monkeypatch.setattr(
                kind, "allocate", lambda self, size, **how: sizes.append(size) or allocate(self, size, **how)
            )
            monkeypatch.setattr(program, "_compile", lambda *given: compiled.append(given) or compile_now(*given))
            for frame in range(1, 20):
                tracer.update(deform(mesh, frame))
                tracer.closest_hit([[0, 0, 9]], [[0, 0, -1]])
            assert sizes == compiled == []
            assert 2 * once < tracer.memory_bytes < 3 * once
        assert tracer._caster.session.buffer_count == 0

    def test_copies_that_only_queries_need_go_back(self, bvh, mesh):
        with Tracer(bvh) as tracer:
            once, casters = tracer.memory_bytes, []
            expected = answers(tracer)
            for frame in range(3):
                casters.append(tracer._caster)
                tracer.update(deform(mesh, frame))
                scratch = tracer.memory_bytes - (2 + frame) * once
            assert tracer.memory_bytes == 4 * once + scratch
            # The tracer as it was when it had the first caster.
            first = Tracer.__new__(Tracer)
            first.__dict__.update(vars(tracer), _caster=casters[0])
            assert answers(first) == expected
            del first
            casters.clear()
            tracer.update(deform(mesh, 3))
            assert tracer.memory_bytes == 2 * once + scratch
            assert tracer._caster.session.buffer_count == 10
            assert answers(tracer) == answers_of_new(bvh, deform(mesh, 3))


class TestFailures:
    def test_bad_vertices_change_nothing(self, bvh, mesh):
        good = deform(mesh, 7)
        refused = (
            (good[1:], "cannot replace the mesh's"),
            (good[:, :2], "shape \\(V, 3\\)"),
            (None, "shape \\(V, 3\\)"),
            (good + 1j, "must be numbers"),
            (np.vstack((good[:7], [[0, np.nan, 0]], good[8:])), "vertex 7 has a coordinate that is not finite"),
            (good * 1e-160, "units wide"),
            (good * 1e160, "units wide"),
            ([*good[1:].tolist(), [0, 0]], "differ in length"),
        )
        with Tracer(bvh) as tracer:
            tracer.update(deform(mesh, 0))
            expected, moved = answers(tracer), tracer.mesh
            for vertices, words in refused:
                with pytest.raises(MeshError, match=words):
                    tracer.update(vertices)
                assert tracer.mesh is moved
            assert answers(tracer) == expected
        with pytest.raises(QueryError, match="the tracer is closed"):
            tracer.update(good)

    @pytest.mark.parametrize("is_first", [True, False])
    def test_an_update_that_breaks_off_changes_nothing(self, bvh, mesh, monkeypatch, is_first):
        """Before the first one, without room for a copy; then, in the middle of what is written."""

        def refuse(self, size, **how):
            raise DeviceMemoryError("full")

        write = Refit.write

        def write_half(self, before, moved, geometry_id, shape, session):
            write(self, before, moved, geometry_id, mesh.with_vertices(mesh.vertices[::-1]), session)
            raise KeyboardInterrupt

        with Tracer(bvh) as tracer:
            if not is_first:
                tracer.update(deform(mesh, 0))
            expected, moved, growth = answers(tracer), tracer.mesh, tracer.sah_growth
            for error, owner, name, fault in (
                *([(DeviceMemoryError, type(tracer._caster.session), "allocate", refuse)] if is_first else []),
                (KeyboardInterrupt, Refit, "write", write_half),
            ):
                with monkeypatch.context() as patch:
                    patch.setattr(owner, name, fault)
                    with pytest.raises(error):
                        tracer.update(deform(mesh, 1))
                assert (tracer.mesh is moved, tracer.sah_growth) == (True, growth)
                assert answers(tracer) == expected
            tracer.update(deform(mesh, 2))
            assert answers(tracer) == answers_of_new(bvh, deform(mesh, 2))
            assert tracer.memory_bytes < 3 * tracer._caster.world.memory_bytes


class TestRunningQueries:
    def test_updates_wait_for_each_other(self, bvh, mesh, monkeypatch):
        writing, most, write = [], [], Refit.write

        def write_slowly(self, *given):
            writing.append(None)
            most.append(len(writing))
            time.sleep(0.05)
            writing.pop()
            return write(self, *given)

        monkeypatch.setattr(Refit, "write", write_slowly)
        with Tracer(bvh) as tracer:
            with ThreadPoolExecutor(4) as threads:
                list(threads.map(tracer.update, [deform(mesh, frame) for frame in range(4)]))
            assert max(most) == 1

    def test_an_update_does_not_wait_for_queries_of_other_threads(self, bvh, mesh, rays):
        is_inside, is_updated = threading.Event(), threading.Event()

        def pause(done, total):
            is_inside.set()
            assert is_updated.wait(60)

        with Tracer(bvh) as tracer, ThreadPoolExecutor(1) as threads:
            expected = tracer.closest_prim(*rays)
            found = threads.submit(tracer.closest_prim, *rays, progress=pause)
            assert is_inside.wait(60)
            for frame in range(3):
                tracer.update(deform(mesh, frame))
            is_updated.set()
            np.testing.assert_array_equal(found.result(), expected)
