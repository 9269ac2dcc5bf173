"""Few rays are cast on the host: with the device's answers to the last bit, and its errors."""

from dataclasses import replace

import numpy as np
import pytest

from clbvh import DeviceError, Mesh, QueryError, Scene, Tracer
from clbvh.device.context import _OpenCL
from clbvh.device.session import DeviceSession
from clbvh.structs import NO_PRIM
from clbvh.trace import launch
from clbvh.trace.hits import closest
from clbvh.trace.put_rays import cut_batch, put_rays
from clbvh.trace.rays.batch import read_rays

from ...rays import hard_rays
from ...soup import make_soup

LAYOUTS = ["bvh4", "bvh8"]
FIELDS = ("t", "u", "v", "prim_id", "is_front")
DOWN = [[0.25, 0.25, 2.0]], [[0.0, 0.0, -1.0]]
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]


@pytest.fixture
def any_number_here(monkeypatch):
    """A function that lets the host cast any number of rays, and fails where the device is asked."""

    def fail(*arguments, **named):
        raise AssertionError("a kernel was started")

    def begin():
        monkeypatch.setattr(launch, "MOST_HOST_RAYS", 1 << 20)
        monkeypatch.setattr(DeviceSession, "run", fail)

    return begin


@pytest.fixture
def launches(monkeypatch, host_casts_few):
    """The names of the kernels that are started from now on."""
    names, run = [], DeviceSession.run

    def record(session, kernel, *arguments, **named):
        names.append(kernel.name)
        run(session, kernel, *arguments, **named)

    monkeypatch.setattr(DeviceSession, "run", record)
    return names


def ask(tracer, rays, **limits):
    """The bytes of all answers."""
    hits = tracer.closest_hit(*rays, **limits)
    answers = [getattr(hits, name) for name in FIELDS]
    answers += [query(*rays, **limits) for query in (tracer.closest_prim, tracer.any_hit, tracer.count_hits)]
    return [values.tobytes() for values in (*answers, tracer.count_hits(*rays, max_hits=2, **limits))]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_hard_rays_have_the_bits_of_the_device(open_tracer, mesh, rays, any_number_here, layout):
    tracer, generator = open_tracer(mesh, layout=layout), np.random.default_rng(5)
    often = generator.random((2, len(rays[0]))) < 0.5
    limits = {"t_min": np.where(often[0], generator.uniform(0, 1, often.shape[1]), 0)}
    limits["t_max"] = np.where(often[1], np.inf, generator.uniform(0.5, 2, often.shape[1]))
    around = np.zeros((500, 3)), generator.normal(size=(500, 3))
    expected = ask(tracer, rays), ask(tracer, rays, **limits)
    any_number_here()
    assert (ask(tracer, rays), ask(tracer, rays, **limits)) == expected
    # Boxes around the origin are entered at t_min, whose bits are those of the greatest distance for -0.
    assert ask(tracer, around, t_min=-0.0) == ask(tracer, around, t_min=0.0)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_equal_and_degenerate_triangles_have_the_bits_of_the_device(session, any_number_here, layout):
    soup = make_soup(400, seed=0, grid=12, size=6, copies=0.4, degenerate=0.2)
    rays = hard_rays(soup, 3000, np.random.default_rng(0))
    with Tracer(soup, device=session.info, layout=layout) as tracer:
        expected = ask(tracer, rays)
        assert tracer.any_hit(*rays).sum() > 100
        any_number_here()
        assert ask(tracer, rays) == expected


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_t_of_the_device_is_the_last_one_that_hits(open_tracer, mesh, rays, any_number_here, layout):
    """To the last bit: a t_max of the t found is within the limits, and the number below it is not."""
    # Directions with a longest component of 1 are not scaled on their way, so neither is t.
    directions = rays[1] / np.abs(rays[1]).max(axis=1, keepdims=True)
    directions = directions.astype(np.float32).astype(np.float64)
    directions[np.arange(len(directions)), np.abs(directions).argmax(axis=1)] = 1.0
    tracer, (batch, shape) = open_tracer(mesh, layout=layout), read_rays(rays[0], directions, 0.0, np.inf)
    with tracer._caster.open_call() as call:
        (piece,) = cut_batch(call, batch, shape)
        with call.cast(closest.CLOSEST_HIT, put_rays(call, batch, piece)) as found:
            t, is_hit = found["t"].copy(), found["prim_id"] != NO_PRIM
    any_number_here()
    hits = rays[0][is_hit], directions[is_hit]
    assert is_hit.sum() > 500
    assert tracer.any_hit(*hits, t_max=t[is_hit]).all()
    assert not tracer.any_hit(*hits, t_max=np.nextafter(t[is_hit], np.float32(-1))).any()


def test_few_rays_at_a_mesh_are_cast_on_the_host(open_tracer, mesh, rays, session, launches, monkeypatch):
    tracer, most, few = open_tracer(mesh, layout="bvh8"), 1500, [part[:3] for part in rays]
    monkeypatch.setattr(launch, "MOST_HOST_RAYS", 4 * most)
    ask(tracer, [part[:most] for part in rays])
    alone = Scene()
    alone.place(alone.add(mesh))
    hits = open_tracer(alone, layout="bvh8").closest_hit(*few)
    assert hits.t.tobytes() == tracer.closest_hit(*few).t.tobytes()
    tracer.any_hit(np.empty((0, 3)), np.empty((0, 3)))
    assert launches == []
    # But not more, for those who compare devices, in the binary layout, or among instances.
    tracer.any_hit(*(part[: most + 1] for part in rays))
    with launch.device_casts_all():
        tracer.any_hit(*few)
    open_tracer(mesh, layout="bvh2").any_hit(*few)
    alone.place(alone.geometries[0], mask=2)
    with Tracer(alone, device=session.info, layout="bvh8") as of_two:
        of_two.any_hit(*few)
    # Nor where the device has memory of its own.
    monkeypatch.setattr(tracer._caster.world.trees.session, "info", replace(session.info, kind="gpu"))
    tracer.any_hit(*few)
    assert launches == ["any_hit"] * 5


def test_bad_rays_are_named_as_by_the_device(session, host_casts_few, monkeypatch):
    many = np.arange(4000)[:, None]  # for several threads
    with Tracer((np.array(TRIANGLE[0]) * 1e-9, TRIANGLE[1]), device=session.info, layout="bvh8") as tracer:
        for most in (launch.MOST_HOST_RAYS, 0):
            monkeypatch.setattr(launch, "MOST_HOST_RAYS", most)
            for origins, directions, message in (
                ([[0, 0, 0], [0, np.nan, 0]], [0, 0, 1], r"^origins\[1\] is not finite: \[ 0. nan  0.\]$"),
                ([0, 0, 0], [[0, 0, 1], [1, 0, 0], [0, 0, 0]], r"^directions\[2\] has length zero$"),
                ([1e308, 0, 0], [0, 0, 1], "^origins is too far"),
                (np.where(many == 3900, np.inf, (0, 0, 0)), [0, 0, 1], r"^origins\[3900\] is"),
                (np.where(many % 2000 == 1900, np.inf, (0, 0, 0)), [0, 0, 1], r"^origins\[1900\] is"),
            ):
                for query in (tracer.closest_hit, tracer.any_hit):
                    with pytest.raises(QueryError, match=message):
                        query(origins, directions)


def test_the_life_of_a_tracer_is_the_same(session, host_casts_few, monkeypatch):
    tracer, told = Tracer(TRIANGLE, device=session.info, layout="bvh8"), []
    assert tracer.any_hit(*DOWN).all()
    before = tracer.timings_ms["kernel"]
    tracer.closest_hit(*DOWN)
    assert tracer.timings_ms["kernel"] > before > 0
    with monkeypatch.context() as patch:
        patch.setattr(_OpenCL, "is_inherited", True)
        with pytest.raises(DeviceError, match="forked"):
            tracer.any_hit(*DOWN)
    held = tracer._caster.session._held
    assert len(held) == 2
    # Progress is told once, and may close.
    tracer.any_hit(*DOWN, progress=lambda *counts: (told.append(counts), tracer.close()))
    assert told == [(1, 1)]
    assert not held
    with pytest.raises(QueryError, match="the tracer is closed"):
        tracer.any_hit(*DOWN)


def test_updates_are_followed(session, host_casts_few):
    """In both copies of the tree, each written while the host has seen it before."""
    # A triangle that stays: a mesh that moves as a whole keeps its tree.
    vertices = np.array([*TRIANGLE[0], [5, 5, 0], [6, 5, 0], [5, 6, 0]], np.float64)
    moves = np.array([[1, 0, 0]] * 3 + [[0, 0, 0]] * 3)
    with Tracer(Mesh.from_arrays(vertices, [[0, 1, 2], [3, 4, 5]]), device=session.info, layout="bvh8") as tracer:
        for way in (0.0, 3.0, 0.0, 3.0, 3.0, 0.0):
            tracer.update(vertices + way * moves)
            assert tracer.any_hit(*DOWN).tolist() == [way == 0.0]
            assert tracer.closest_hit([[5.25, 5.25, 2]], DOWN[1]).t.tolist() == [2.0]
