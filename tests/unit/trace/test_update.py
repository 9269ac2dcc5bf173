"""A tracer whose mesh moves: the answers of a new tracer, the same buffers, and nothing half done."""

from __future__ import annotations

import gc
import sys
import threading
import time

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, OpenMeshWarning, Tracer, build, make_shape, sah_cost
from clbvh.device import program
from clbvh.device.session import DeviceSession
from clbvh.errors import DeviceMemoryError, MeshError, QueryError
from clbvh.layouts.refit_arrays import RefitArrays
from clbvh.structs import LAYOUT_WIDTHS
from clbvh.trace.rays import pieces
from clbvh.trace.world import changes, trees

from ...concurrency.queries import ask, make_queries
from ...deform import deform
from ...mesh_reference import find_differences
from ...rays import hard_rays
from ..hand_made import make_leaf, make_tree
from .test_tracer import record_allocations

LAYOUTS = [*LAYOUT_WIDTHS]

# Answers about open meshes are compared as well.
IGNORES_OPEN_MESHES = pytest.mark.filterwarnings("ignore::clbvh.OpenMeshWarning")


@pytest.fixture(scope="module")
def mesh():
    return make_shape("knot", triangles=1800)


@pytest.fixture(scope="module")
def bvh(mesh):
    return build(mesh)


def answers(tracer, sizes=(1, 300), seed=0):
    return [ask(tracer, *query) for query in make_queries(tracer.mesh, sizes, seed)]


def answers_of_new(bvh, vertices, layout="auto"):
    with Tracer(bvh.refit(vertices), layout=layout) as tracer:
        return answers(tracer)


def strikes_at(line, work):
    """Do some work with Ctrl-C before one of the lines of a change run; false if there are fewer."""
    left = [line]

    def strike(frame, event, _):
        if event == "line":
            left[0] -= 1
            if left[0] < 0:
                sys.settrace(None)
                raise KeyboardInterrupt
        return strike

    def watch(frame, event, _):
        return strike if frame.f_code.co_filename in (changes.__file__, trees.__file__) else None

    traced = sys.gettrace()
    sys.settrace(watch)
    try:
        work()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(traced)
    return False


class TestAnswers:
    @pytest.mark.parametrize("layout", LAYOUTS)
    def test_they_are_those_of_a_new_tracer(self, bvh, mesh, layout):
        with Tracer(bvh, layout=layout) as tracer:
            for frame in range(5):
                vertices = deform(mesh, frame)
                tracer.update(vertices)
                assert answers(tracer) == answers_of_new(bvh, vertices, layout)

    @pytest.mark.parametrize("layout", LAYOUTS)
    def test_they_are_those_of_the_oracle(self, bvh, mesh, layout):
        with Tracer(bvh, layout=layout) as tracer:
            tracer.update(deform(mesh, 0))
            tracer.update(deform(mesh, 1))
            rays = hard_rays(tracer.mesh, 2000, np.random.default_rng(1))
            hits = tracer.closest_hit(*rays)
            assert hits.is_hit.mean() > 0.2
            assert find_differences(tracer.mesh, *rays, hits) == []

    @pytest.mark.parametrize("layout", LAYOUTS)
    def test_the_mesh_may_have_any_size_and_place(self, bvh, mesh, layout):
        with Tracer(bvh, layout=layout) as tracer:
            for unit, shift in [(1e-149, 0), (1e149, 0), (1e-30, 1e-20), (1e30, 0), (1, 1e9), (1, 0)]:
                vertices = deform(mesh, 2) * unit + shift
                tracer.update(vertices)
                assert answers(tracer) == answers_of_new(bvh, vertices, layout)
                assert (tracer.mesh.vertices == vertices).all()

    @pytest.mark.parametrize("layout", LAYOUTS)
    def test_triangles_may_lose_their_area_and_get_it_again(self, bvh, mesh, layout):
        flat = deform(mesh, 3) * [1, 1, 0]
        with Tracer(bvh, layout=layout) as tracer:
            for vertices in (np.zeros_like(flat), flat, flat * [1, 0, 0], deform(mesh, 3)):
                tracer.update(vertices)
                rays = hard_rays(mesh, 500, np.random.default_rng(4))
                with Tracer(bvh.refit(vertices), layout=layout) as new:
                    for kind in ("closest_hit", "count_hits", "all_hits"):
                        assert ask(tracer, kind, rays) == ask(new, kind, rays)

    @IGNORES_OPEN_MESHES
    @pytest.mark.parametrize("layout", LAYOUTS)
    @pytest.mark.parametrize("make", [make_tree, make_leaf])
    def test_hand_made_trees_of_one_leaf_and_of_five_nodes(self, layout, make):
        bvh = make()
        with Tracer(bvh, layout=layout) as tracer:
            tracer.update(bvh.mesh.vertices[:, [1, 0, 2]] * 3)
            assert answers(tracer) == answers_of_new(bvh, bvh.mesh.vertices[:, [1, 0, 2]] * 3, layout)

    @IGNORES_OPEN_MESHES
    @pytest.mark.parametrize("dtype", [np.float32, np.float16, np.int64, ">f8", np.longdouble])
    def test_vertices_of_any_kind(self, dtype):
        bvh = make_tree()
        vertices = (bvh.mesh.vertices * 2).astype(dtype)
        with Tracer(bvh) as tracer:
            strided = np.repeat(vertices, 2, axis=0)[::2]
            for given in (vertices, vertices.tolist(), np.asfortranarray(vertices), strided):
                tracer.update(given)
                assert (tracer.mesh.vertices == bvh.mesh.vertices * 2).all()
                assert answers(tracer) == answers_of_new(bvh, vertices)


class TestResults:
    def test_earlier_hits_keep_their_mesh_and_their_locations(self, bvh, mesh):
        rays = hard_rays(mesh, 500, np.random.default_rng(5))
        with Tracer(bvh) as tracer:
            assert tracer.mesh is mesh
            before = tracer.closest_hit(*rays)
            expected = tracer.closest_hit(*rays).locations.tobytes()
            tracer.update(deform(mesh, 1))
            assert tracer.mesh is not mesh
            after = tracer.closest_hit(*rays)
            assert before.mesh is mesh
            assert after.mesh is tracer.mesh
            tracer.update(deform(mesh, 2))
            tracer.update(deform(mesh, 3))
            assert before.locations.tobytes() == expected
            assert after.mesh is not tracer.mesh

    def test_the_callers_tree_and_vertices_stay_as_they_were(self, mesh):
        bvh = build(mesh)
        stored = bvh.nodes.tobytes(), bvh.prim_ids.tobytes(), mesh.vertices.tobytes(), mesh.local_vertices.tobytes()
        vertices = deform(mesh, 1)
        given = vertices.copy()
        vertices.flags.writeable = False
        with Tracer(bvh) as tracer:
            tracer.update(vertices)
            assert (vertices == given).all()
            assert not np.shares_memory(tracer.mesh.vertices, vertices)
        now = bvh.nodes.tobytes(), bvh.prim_ids.tobytes(), mesh.vertices.tobytes(), mesh.local_vertices.tobytes()
        assert stored == now
        assert bvh.mesh is mesh

    def test_the_growth_is_that_of_the_sah_cost(self, bvh, mesh):
        with Tracer(bvh, layout="bvh2") as tracer:
            assert tracer.sah_growth == 1.0
            tracer.update(mesh.vertices)
            assert tracer.sah_growth == 1.0
            shuffled = np.random.default_rng(6).permutation(mesh.vertices)
            tracer.update(shuffled)
            assert tracer.sah_growth == pytest.approx(sah_cost(bvh.refit(shuffled)) / sah_cost(bvh), rel=1e-12)
            assert tracer.sah_growth > 5
            tracer.update(mesh.vertices[:, ::-1] * 2.0**70 + 2.0**70)
            assert tracer.sah_growth == pytest.approx(1.0)

    @pytest.mark.parametrize("layout", LAYOUTS)
    def test_a_mesh_that_was_opened_without_extent_has_a_growth(self, layout):
        flat = Mesh.from_arrays(np.zeros((3, 3)), [[0, 1, 2]])
        with Tracer(flat, layout=layout) as tracer:
            tracer.update(np.eye(3))
            assert tracer.sah_growth > 0
            tracer.update(np.zeros((3, 3)))
            assert tracer.sah_growth == 1.0

    def test_a_mesh_that_tears_is_told(self):
        ball = trimesh.creation.icosphere(subdivisions=2)
        torn = ball.triangles.reshape(-1, 3)
        with Tracer((torn, np.arange(len(torn)).reshape(-1, 3))) as tracer:
            assert tracer.contains([[0.0, 0, 0]]).all()
            tracer.update(np.concatenate((torn[:3] * 1.5, torn[3:])))
            with pytest.warns(OpenMeshWarning):
                tracer.contains([[0.0, 0, 0]])


class TestResources:
    def test_buffers_and_kernels_are_kept(self, bvh, mesh, session, monkeypatch):
        compiled, compile_now = [], program._compile
        monkeypatch.setattr(program, "_compile", lambda *given: compiled.append(given) or compile_now(*given))
        with Tracer(bvh, device=session.info) as tracer:
            once = tracer.memory_bytes
            assert once == tracer._caster.world.memory_bytes
            tracer.closest_hit([[0, 0, 9]], [[0, 0, -1]])
            tracer.update(deform(mesh, 0))
            sizes = record_allocations(monkeypatch)
            compiled.clear()
            for frame in range(1, 20):
                tracer.update(deform(mesh, frame))
                tracer.closest_hit([[0, 0, 9]], [[0, 0, -1]])
            assert sizes == []
            assert compiled == []
            assert tracer.memory_bytes == 2 * once
        assert tracer._caster.session.buffer_count == 0

    def test_old_meshes_are_forgotten(self, bvh, mesh):
        with Tracer(bvh) as tracer:
            for frame in range(4):
                tracer.update(deform(mesh, frame))
            gc.collect()
            moved = [found for found in gc.get_objects() if isinstance(found, Mesh) and found.faces is mesh.faces]
            assert len([found for found in moved if found is not mesh]) == 1

    def test_copies_that_only_queries_need_go_back(self, bvh, mesh):
        with Tracer(bvh) as tracer:
            once = tracer.memory_bytes
            casters = []
            for frame in range(3):
                casters.append(tracer._caster)
                tracer.update(deform(mesh, frame))
            assert tracer.memory_bytes == 4 * once
            expected = [ask(caster_tracer(tracer, caster), *query) for caster in casters
                        for query in make_queries(mesh, (50,), 1)]  # fmt: skip
            with Tracer(bvh) as first:
                assert expected[: len(expected) // 3] == [ask(first, *query) for query in make_queries(mesh, (50,), 1)]
            casters.clear()
            tracer.update(deform(mesh, 3))
            assert tracer.memory_bytes == 2 * once
            assert tracer._caster.session.buffer_count == 4
            assert answers(tracer) == answers_of_new(bvh, deform(mesh, 3))


def caster_tracer(tracer, caster):
    """A tracer as it was when it had that caster."""
    earlier = Tracer.__new__(Tracer)
    earlier.__dict__.update(vars(tracer))
    earlier._caster = caster
    return earlier


class TestFailures:
    @pytest.mark.parametrize(
        ("spoil", "message"),
        [
            (lambda vertices: vertices[1:], "cannot replace the mesh's"),
            (lambda vertices: np.concatenate((vertices, vertices[:1])), "cannot replace the mesh's"),
            (lambda vertices: vertices[:, :2], r"shape \(V, 3\)"),
            (lambda vertices: vertices.ravel(), r"shape \(V, 3\)"),
            (lambda vertices: [], r"shape \(V, 3\)"),
            (lambda vertices: None, r"shape \(V, 3\)"),
            (lambda vertices: "abc", r"shape \(V, 3\)"),
            (lambda vertices: vertices + 1j, "must be numbers"),
            (lambda vertices: vertices > 0, "must be numbers"),
            (lambda vertices: np.vstack((vertices[:7], [[0, np.nan, 0]], vertices[8:])), "vertex 7 .*y = nan"),
            (lambda vertices: np.where(vertices > 0, np.inf, vertices), "not finite"),
            (lambda vertices: vertices * 1e-160, "units wide"),
            (lambda vertices: vertices * 1e160, "units wide"),
            (lambda vertices: [*vertices[1:].tolist(), [0, 0]], "differ in length"),
        ],
    )  # fmt: skip
    def test_bad_vertices_change_nothing(self, bvh, mesh, spoil, message):
        with Tracer(bvh) as tracer:
            for frame in range(2):
                expected, moved = answers(tracer), tracer.mesh
                with pytest.raises(MeshError, match=message):
                    tracer.update(spoil(deform(mesh, 7)))
                assert tracer.mesh is moved
                assert answers(tracer) == expected
                tracer.update(deform(mesh, frame))

    @pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
    @pytest.mark.parametrize("is_first", [True, False])
    @pytest.mark.parametrize("is_late", [True, False])
    def test_an_update_that_breaks_off_changes_nothing(self, bvh, mesh, monkeypatch, error, is_first, is_late):
        with Tracer(bvh) as tracer:
            if not is_first:
                tracer.update(deform(mesh, 0))
            expected, moved, growth = answers(tracer), tracer.mesh, tracer.sah_growth
            write = RefitArrays.write

            def write_half(self, mesh, nodes, blocks, threads):
                if is_late:
                    write(self, mesh, nodes, blocks, threads)
                nodes.view(np.uint8)[::3] = 0xAA
                raise error

            with monkeypatch.context() as patch:
                patch.setattr(RefitArrays, "write", write_half)
                with pytest.raises(error):
                    tracer.update(deform(mesh, 1))
            assert tracer.mesh is moved
            assert tracer.sah_growth == growth
            assert answers(tracer) == expected
            tracer.update(deform(mesh, 2))
            assert answers(tracer) == answers_of_new(bvh, deform(mesh, 2))
            assert tracer.memory_bytes == 2 * tracer._caster.world.memory_bytes

    def test_a_device_without_room_for_a_copy(self, bvh, mesh, session, monkeypatch):
        with Tracer(bvh, device=session.info) as tracer:
            expected, allocate = answers(tracer), DeviceSession.allocate
            buffers = tracer._caster.session.buffer_count

            def refuse(self, size, *, writable=True, **how):
                if not writable and self.buffer_count > buffers:
                    raise DeviceMemoryError("full")
                return allocate(self, size, writable=writable, **how)

            with monkeypatch.context() as patch:
                patch.setattr(DeviceSession, "allocate", refuse)
                with pytest.raises(DeviceMemoryError):
                    tracer.update(deform(mesh, 1))
            assert tracer._caster.session.buffer_count == buffers
            assert answers(tracer) == expected
            tracer.update(deform(mesh, 1))
            assert answers(tracer) == answers_of_new(bvh, deform(mesh, 1))

    def test_ctrl_c_at_any_line_leaves_no_buffers_behind(self, bvh, mesh):
        is_struck, line = True, 0
        while is_struck:
            with Tracer(bvh) as tracer:
                session, moved = tracer._caster.session, tracer.mesh
                buffers = session.buffer_count
                is_struck = strikes_at(line, lambda tracer=tracer: tracer.update(deform(mesh, 1)))
                # It is as before the update, or as after it.
                assert tracer.mesh is moved or (tracer.mesh.vertices == deform(mesh, 1)).all()
                tracer.update(deform(mesh, 2))
                tracer.update(deform(mesh, 3))
                assert session.buffer_count == 2 * buffers
                assert tracer.memory_bytes == 2 * tracer._caster.world.memory_bytes
                if line % 10 == 0:
                    assert answers(tracer) == answers_of_new(bvh, deform(mesh, 3))
            line += 1
        assert line > 20

    def test_a_closed_tracer_refuses(self, bvh, mesh):
        tracer = Tracer(bvh)
        tracer.update(deform(mesh, 1))
        moved = tracer.mesh
        tracer.close()
        with pytest.raises(QueryError, match="the tracer is closed"):
            tracer.update(deform(mesh, 2))
        assert tracer.mesh is moved


class TestRunningQueries:
    @pytest.mark.parametrize("kind", ["closest_hit", "all_hits", "closest_point", "signed_distance"])
    def test_a_query_ends_on_the_mesh_that_it_began_with(self, bvh, mesh, monkeypatch, kind):
        monkeypatch.setattr(pieces, "CHUNK_RAYS", 100)
        ((_, arguments),) = [query for query in make_queries(mesh, (450,), 2) if query[0] == kind]
        with Tracer(bvh) as tracer:
            expected = ask(tracer, kind, arguments)
            frames = iter(range(100))

            def move(done, total):
                tracer.update(deform(mesh, next(frames)))

            assert ask_with_progress(tracer, kind, arguments, move) == expected
            assert next(frames) >= 5
            assert ask(tracer, kind, arguments) != expected

    def test_hits_of_a_query_in_which_the_mesh_moved_know_their_mesh(self, bvh, mesh):
        rays = hard_rays(mesh, 100, np.random.default_rng(3))
        with Tracer(bvh) as tracer:
            hits = tracer.closest_hit(*rays, progress=lambda done, total: tracer.update(deform(mesh, 1)))
            assert hits.mesh is mesh
            assert tracer.mesh is not mesh

    def test_updates_wait_for_each_other(self, bvh, mesh, monkeypatch):
        writing, most, write = [], [], RefitArrays.write

        def write_slowly(self, *given):
            writing.append(None)
            most.append(len(writing))
            time.sleep(0.05)
            write(self, *given)
            writing.pop()

        monkeypatch.setattr(RefitArrays, "write", write_slowly)
        with Tracer(bvh) as tracer:
            threads = [threading.Thread(target=tracer.update, args=(deform(mesh, frame),)) for frame in range(4)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            assert max(most) == 1

    def test_an_update_does_not_wait_for_queries_of_other_threads(self, bvh, mesh):
        rays = hard_rays(mesh, 100, np.random.default_rng(3))
        is_inside, is_updated = threading.Event(), threading.Event()
        with Tracer(bvh) as tracer:
            expected, found = tracer.closest_prim(*rays), []

            def pause(done, total):
                is_inside.set()
                assert is_updated.wait(60)

            thread = threading.Thread(target=lambda: found.append(tracer.closest_prim(*rays, progress=pause)))
            thread.start()
            assert is_inside.wait(60)
            for frame in range(3):
                tracer.update(deform(mesh, frame))
            is_updated.set()
            thread.join()
            np.testing.assert_array_equal(found[0], expected)


def ask_with_progress(tracer, kind, arguments, progress):
    """Answer a query during which a function is called."""

    class Told:
        def __getattr__(self, name):
            return lambda *rays: getattr(tracer, name)(*rays, progress=progress)

    return ask(Told(), kind, arguments)
