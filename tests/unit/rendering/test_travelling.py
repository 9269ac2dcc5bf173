"""Tracers, renderers and references that go to another process: here through a pickle, in this one."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import QueryError, Renderer, SceneRef, Tracer, Transform, View, make_shape
from clbvh.builders import tree_cache
from clbvh.support import opened
from clbvh.trace import tracer as tracer_module

FIELDS = "t", "u", "v", "prim_id", "instance_id"


@pytest.fixture(autouse=True)
def _nothing_kept():
    opened._kept.clear()
    yield
    opened._kept.clear()


@pytest.fixture
def openings(monkeypatch):
    """A list that gets the scene of every world that is opened from now on."""
    states, open_world = [], tracer_module.open_world

    def record(session, state, *more):
        states.append(state)
        return open_world(session, state, *more)

    monkeypatch.setattr(tracer_module, "open_world", record)
    return states


def send(thing):
    return pickle.loads(pickle.dumps(thing))


def bytes_of(tracer, rays):
    hits = tracer.closest_hit(*rays)
    return [getattr(hits, name).tobytes() for name in FIELDS]


def write_ball(path, radius=1.0):
    trimesh.creation.icosphere(2, radius).export(path)
    return path


class TestTracers:
    def test_many_copies_are_opened_once_and_answer_alike(self, session, source, rays, openings):
        with Tracer(source, layout="bvh2") as tracer:
            expected = bytes_of(tracer, rays)
            copies = [send(tracer) for _ in range(5)]
        assert len(openings) == 2
        assert {each.layout for each in copies} == {"bvh2"}
        for each in copies:
            assert bytes_of(each, rays) == expected

    def test_the_same_content_is_opened_once_whatever_was_asked_of_it_before(self, session, openings):
        mesh = make_shape("knot", triangles=500)
        tracer = Tracer(mesh)
        before = send(tracer)
        assert (mesh.is_watertight, len(mesh.fingerprint), mesh.degenerate_count) == (True, 32, 0)
        after = send(Tracer(mesh.with_vertices(mesh.vertices)))
        assert len(openings) == 3
        assert before.mesh is after.mesh

    def test_what_one_copy_changes_or_closes_no_other_one_sees(self, session, world, rays):
        with Tracer(world) as tracer:
            expected = bytes_of(tracer, rays)
            first, second = send(tracer), send(tracer)
        for step in range(3):
            first.set_transforms(1, Transform(translate=(step, 0, 9)).matrix)
            first.set_vertices(first._opening.scene.geometries[0], world.geometries[0].shape.vertices * (1 + step))
        assert bytes_of(first, rays) != expected
        first.close()
        assert bytes_of(second, rays) == expected == bytes_of(send(second), rays)

    def test_a_moved_tracer_goes_as_it_is_now_and_its_handles_go_along(self, session, world, rays):
        with Tracer(world) as tracer:
            tracer.set_transforms(1, Transform(translate=(0, 0, 1)).matrix)
            copied, instance, geometry = send((tracer, world.instances[1], world.geometries[0]))
            assert bytes_of(copied, rays) == bytes_of(tracer, rays)
        copied.set_transforms(instance, Transform(translate=(0, 0, 99)).matrix)
        assert copied.closest_point([0, 0, 99], geometry=geometry).instance_id == 1

    def test_a_given_tree_goes_along_until_its_vertices_move(self, session, mesh, rays):
        bvh = clbvh.build(mesh, leaf_size=1)
        with Tracer(bvh) as tracer:
            copied = send(tracer)
            assert copied.bvh.nodes.tobytes() == bvh.nodes.tobytes()
            tracer.update(mesh.vertices * 2)
            assert bytes_of(send(tracer), rays) == bytes_of(tracer, rays)

    def test_the_device_goes_as_it_was_asked_for(self, session, mesh, monkeypatch):
        with Tracer(mesh) as chosen_there, Tracer(mesh, device=session.info) as named:
            pickles = pickle.dumps(chosen_there), pickle.dumps(named)
        monkeypatch.setenv("CLBVH_DEVICE", "no such device")
        assert pickle.loads(pickles[1]).device == session.info
        with pytest.raises(Exception, match="no such device"):
            pickle.loads(pickles[0])

    def test_closed_ones_are_refused(self, session, mesh):
        for each in (Tracer(mesh), Renderer(mesh)):
            each.close()
            with pytest.raises(QueryError, match=r"closed .* cannot be pickled"):
                pickle.dumps(each)


def test_renderers_are_opened_once_and_end_alone(session, world):
    view = View(width=48, height=32, side="top")
    with Renderer(world, view, clbvh.RenderOptions(layout="bvh2")) as renderer:
        expected = renderer.render().rgb
        first, second = send(renderer), copy.deepcopy(renderer)
    assert first.tracer._caster.world is second.tracer._caster.world
    assert (first.layout, first.view) == ("bvh2", view)
    assert (first.render().rgb == expected).all()
    # Each moves alone, and travels as it is.
    first.set_transforms(0, Transform(scale=0.5))
    moved = first.render().rgb
    assert (send(first).render().rgb == moved).all()
    assert (second.render().rgb == expected).all()
    assert (moved != expected).any()
    first.close()
    assert (second.render().rgb == expected).all()


class TestReferences:
    @pytest.mark.parametrize("kind", ["ply", "obj", "toml", "embedded"])
    def test_any_scene_travels_and_gives_the_same_bytes(self, session, tmp_path, rays, kind):
        part = write_ball(tmp_path / "part.ply")
        path = tmp_path / f"ball.{kind}"
        if kind == "toml":
            path.write_text('[[object]]\npath = "part.ply"\n[[object]]\nspheres = "galaxy"\ncount = 50\n')
        elif kind == "obj":
            write_ball(path)
        ref = SceneRef.embed(part) if kind == "embedded" else SceneRef(part if kind == "ply" else path)
        sent = send(ref)
        assert sent == ref
        if kind == "embedded":
            part.unlink()
        else:
            assert len(pickle.dumps(ref)) < 200 + len(str(path))
        with Tracer(sent.load()[0]) as tracer:
            assert bytes_of(sent.tracer(), rays) == bytes_of(tracer, rays)

    def test_a_tracer_of_one_goes_as_the_reference_until_it_moves(self, session, tmp_path, openings):
        tracer = SceneRef(write_ball(tmp_path / "ball.ply")).tracer(quality="high", layout="bvh4")
        assert len(pickle.dumps(tracer)) < 500
        assert (send(tracer).layout, len(openings)) == ("bvh4", 1)
        tracer.update(tracer.mesh.vertices + np.array([0, 0, 5]))
        (tmp_path / "ball.ply").unlink()
        assert send(tracer).any_hit([0, 0.1, 9], [0, 0, -1], t_max=4)

    @pytest.mark.parametrize("name", ["ball.ply", "ball.toml"])
    def test_another_content_is_refused_by_name_once_it_is_opened(self, session, tmp_path, name):
        write_ball(tmp_path / "ball.ply")
        (tmp_path / "ball.toml").write_text('[[object]]\npath = "ball.ply"\n')
        ref = SceneRef(tmp_path / name)
        ref.tracer()
        write_ball(tmp_path / "ball.ply", radius=2.0)
        ref.tracer()  # open already
        opened._kept.clear()
        with pytest.raises(clbvh.SceneError, match=rf"{name}: .* another content"):
            ref.tracer()
        (tmp_path / "ball.ply").unlink()
        with pytest.raises((clbvh.SceneError, clbvh.MeshError), match=r"ball\.ply: no such file"):
            ref.tracer()

    def test_a_kept_tree_is_used(self, session, tmp_path, monkeypatch):
        monkeypatch.setenv("CLBVH_CACHE", str(tmp_path / "cache"))
        ref = SceneRef(write_ball(tmp_path / "ball.ply"))
        ref.tracer()
        opened._kept.clear()
        monkeypatch.setattr(tree_cache, "build_tree", None)
        assert ref.tracer().any_hit([0, 0.1, 9], [0, 0, -1])

    def test_two_are_kept_and_the_one_that_goes_is_not_closed(self, session, openings):
        refs = [SceneRef.embed(make_shape("knot", triangles=count)) for count in (500, 600, 700)]
        first = refs[0].tracer()
        for ref in (*refs[1:], *refs[1:]):
            ref.tracer()
        assert len(openings) == 3
        assert not first.any_hit([0, 0, 99], [0, 0, 1])
        refs[0].tracer()
        assert len(openings) == 4

    def test_threads_that_ask_at_the_same_time_open_it_once(self, session, rays, openings):
        ref = SceneRef.embed(make_shape("knot", triangles=900))
        with ThreadPoolExecutor(4) as pool:
            answers = list(pool.map(lambda _: bytes_of(ref.tracer(), rays), range(4)))
        assert len(openings) == 1
        assert answers == [answers[0]] * 4
