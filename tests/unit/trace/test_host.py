"""Few rays are cast on the host: with the device's answers to the last bit, and its errors."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from clbvh import Mesh, Scene, Tracer, build
from clbvh.device.session import DeviceSession
from clbvh.errors import DeviceError, QueryError
from clbvh.structs import NO_PRIM
from clbvh.trace import launch
from clbvh.trace.hits import closest
from clbvh.trace.hits.closest import CLOSEST_HIT
from clbvh.trace.host.walk import mean_steps
from clbvh.trace.put_rays import cut_batch, put_rays
from clbvh.trace.rays.batch import read_rays

from ...profiles import seeds
from ...rays import aim, axis_rays, centred, edge_midpoints, hard_rays, random_rays
from ...soup import make_soup

WIDE = ["bvh4", "bvh8"]
FIELDS = ("t", "u", "v", "prim_id", "is_front")

QUERIES = {
    "closest_hit": lambda tracer, rays, **limits: tracer.closest_hit(*rays, **limits),
    "closest_prim": lambda tracer, rays, **limits: tracer.closest_prim(*rays, **limits),
    "any_hit": lambda tracer, rays, **limits: tracer.any_hit(*rays, **limits),
    "count_hits": lambda tracer, rays, **limits: tracer.count_hits(*rays, **limits),
    "count_hits up to 2": lambda tracer, rays, **limits: tracer.count_hits(*rays, max_hits=2, **limits),
}
DOWN = [[0.25, 0.25, 2.0]], [[0.0, 0.0, -1.0]]
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]


@pytest.fixture
def any_number_here(monkeypatch):
    """A function that lets the host cast any number of rays, and fails where the device is asked."""

    def begin():
        def fail(*arguments, **named):
            raise AssertionError("a kernel was started")

        monkeypatch.setattr(launch, "MOST_HOST_RAYS", 1 << 20)
        monkeypatch.setattr(DeviceSession, "run", fail)

    return begin


def read_all(tracer, rays, **limits):
    """The bytes of all answers."""
    answers = [query(tracer, rays, **limits) for query in QUERIES.values()]
    return [
        values.tobytes()
        for answer in answers
        for values in ([answer] if isinstance(answer, np.ndarray) else [getattr(answer, name) for name in FIELDS])
    ]


def make_limits(count, seed):
    generator = np.random.default_rng(seed)
    t_min = generator.uniform(0, 1, count) * (generator.random(count) < 0.5)
    return {"t_min": t_min, "t_max": np.where(generator.random(count) < 0.5, np.inf, generator.uniform(0.5, 2, count))}


class TestBits:
    @pytest.mark.parametrize("layout", WIDE)
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_hard_rays(self, session, mesh, rays, any_number_here, layout, dtype):
        rays = tuple(values.astype(dtype) for values in rays)
        limits = make_limits(len(rays[0]), seed=5)
        with Tracer(build(mesh), device=session.info, layout=layout) as tracer:
            expected = read_all(tracer, rays), read_all(tracer, rays, **limits)
            any_number_here()
            assert (read_all(tracer, rays), read_all(tracer, rays, **limits)) == expected

    @pytest.mark.parametrize("layout", WIDE)
    @pytest.mark.parametrize("seed", seeds(3))
    def test_equal_and_degenerate_triangles(self, session, any_number_here, layout, seed):
        soup = make_soup(400, seed=seed, grid=12, size=6, copies=0.4, degenerate=0.2)
        generator = np.random.default_rng(seed)
        parts = [random_rays(soup, 500, generator), axis_rays(soup, 500, generator)]
        midpoints = edge_midpoints(soup)[:500]
        parts.append(aim(generator.uniform(-5, 20, midpoints.shape), midpoints))
        rays = tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        with Tracer(build(soup), device=session.info, layout=layout) as tracer:
            expected = read_all(tracer, rays)
            assert np.count_nonzero(tracer.closest_prim(*rays) != NO_PRIM) > 100
            any_number_here()
            assert read_all(tracer, rays) == expected

    @pytest.mark.parametrize("size", [1e-30, 1e-3, 1e30])
    @pytest.mark.parametrize("distance", [0.0, 1e6])
    def test_every_size_and_distance(self, session, mesh, any_number_here, size, distance):
        scaled = Mesh.from_arrays(mesh.vertices * size, mesh.faces)
        origins, directions = hard_rays(mesh, 600, np.random.default_rng(3))
        origins = (origins - distance * directions) * size
        with Tracer(build(scaled), device=session.info, layout="bvh8") as tracer:
            expected = read_all(tracer, (origins, directions))
            any_number_here()
            assert read_all(tracer, (origins, directions)) == expected

    @pytest.mark.parametrize("layout", WIDE)
    def test_the_t_of_the_device_is_the_last_one_that_hits(self, session, mesh, rays, any_number_here, layout):
        """To the last bit: a t_max of the t found is within the limits, and the number below it is not."""
        # Directions with a longest component of 1 are not scaled on their way, so neither is t.
        origins = rays[0]
        directions = rays[1] / np.abs(rays[1]).max(axis=1, keepdims=True)
        directions = directions.astype(np.float32).astype(np.float64)
        directions[np.arange(len(directions)), np.abs(directions).argmax(axis=1)] = 1.0
        mesh = centred(mesh)
        with Tracer(build(mesh), device=session.info, layout=layout) as tracer:
            batch, shape = read_rays(origins, directions, 0.0, np.inf)
            with tracer._caster.open_call() as call:
                (piece,) = cut_batch(call, batch, shape)
                with call.cast(CLOSEST_HIT, put_rays(call, batch, piece)) as found:
                    t, is_hit = found["t"].copy(), found["prim_id"] != NO_PRIM
            any_number_here()
            hits = origins[is_hit], directions[is_hit]
            assert is_hit.sum() > 500
            assert tracer.any_hit(*hits, t_max=t[is_hit]).all()
            assert not tracer.any_hit(*hits, t_max=np.nextafter(t[is_hit], np.float32(-1))).any()

    @pytest.mark.parametrize("layout", WIDE)
    def test_a_t_min_of_minus_zero(self, session, mesh, any_number_here, layout):
        """Boxes around the origin are entered at t_min, whose bits are those of the greatest distance for -0."""
        mesh = centred(mesh)
        directions = np.random.default_rng(11).normal(size=(500, 3))
        with Tracer(build(mesh), device=session.info, layout=layout) as tracer:
            any_number_here()
            rays = np.zeros_like(directions), directions
            assert read_all(tracer, rays, t_min=-0.0) == read_all(tracer, rays, t_min=0.0)

    @pytest.mark.parametrize("layout", WIDE)
    def test_small_meshes(self, session, any_number_here, layout):
        no_triangle = Mesh.from_arrays([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2], [0, 0, 1]])
        with (
            Tracer(TRIANGLE, device=session.info, layout=layout) as one,
            Tracer(build(no_triangle), device=session.info, layout=layout) as nothing,
        ):
            any_number_here()
            assert one.closest_hit(*DOWN).t.tolist() == [2.0]
            assert one.closest_prim(DOWN[0][0], DOWN[1][0]).shape == ()
            assert one.count_hits(*DOWN).tolist() == [1]
            assert nothing.closest_prim(*DOWN).tolist() == [NO_PRIM]
            assert nothing.any_hit([[0, 0, 5], [1, 1, 5]], [[0, 0, -1]]).tolist() == [False, False]

    def test_masks_of_a_mesh(self, session, any_number_here):
        with Tracer(TRIANGLE, device=session.info, layout="bvh8") as tracer:
            any_number_here()
            found = tracer.any_hit(DOWN[0] * 3, DOWN[1] * 3, mask=[1, 0, 0xFFFFFFFF])
            assert found.tolist() == [True, False, True]


@pytest.mark.parametrize("width", [4, 8])
def test_steps_are_those_of_the_layout(session, mesh, rays, width):
    bvh = build(mesh)
    batch, _ = read_rays(*rays, 0.0, np.inf)
    with Tracer(bvh, device=session.info, layout=f"bvh{width}") as tracer:
        world = tracer._caster.world
        counted = mean_steps(world.on_host(), world.box, batch)
        steps = closest.count_steps(tracer._caster, *rays)
    assert counted == pytest.approx(steps["node_steps"].mean() + steps["leaf_visits"].mean())
    assert counted > 1


def test_the_steps_of_a_bad_ray_are_infinite(session, mesh):
    batch, _ = read_rays([[0, 0, 5], [np.nan, 0, 0]], [0, 0, -1], 0.0, np.inf)
    with Tracer(build(mesh), device=session.info, layout="bvh8") as tracer:
        world = tracer._caster.world
        assert mean_steps(world.on_host(), world.box, batch) == np.inf


class TestWhere:
    """Where the host casts, and where the device does."""

    @pytest.fixture
    def launches(self, monkeypatch):
        names, run = [], DeviceSession.run
        monkeypatch.setattr(
            DeviceSession, "run", lambda self, kernel, *rest, **named: (
                names.append(kernel.name), run(self, kernel, *rest, **named)
            )[1],
        )  # fmt: skip
        return names

    def test_few_rays_at_a_mesh(self, session, mesh, rays, host_casts_few, launches):
        most = launch.MOST_HOST_RAYS
        with Tracer(build(mesh), device=session.info, layout="bvh8") as tracer:
            for query in QUERIES.values():
                query(tracer, (rays[0][:most], rays[1][:most]))
            assert launches == []
            tracer.any_hit(rays[0][: most + 1], rays[1][: most + 1])
            tracer.any_hit(np.empty((0, 3)), np.empty((0, 3)))
            assert launches == ["any_hit"]

    def test_not_in_the_binary_layout_or_among_instances(self, session, mesh, rays, host_casts_few, launches):
        scene = Scene()
        for _ in range(2):
            scene.place(scene.add(mesh))
        for source, layout in ((build(mesh), "bvh2"), (scene, "bvh8")):
            with Tracer(source, device=session.info, layout=layout) as tracer:
                tracer.closest_hit(rays[0][:3], rays[1][:3])
        assert len(launches) == 2

    def test_at_a_scene_that_is_one_mesh(self, session, mesh, rays, host_casts_few, launches):
        scene = Scene()
        scene.place(scene.add(mesh))
        with Tracer(scene, device=session.info, layout="bvh8") as tracer:
            hits = tracer.closest_hit(rays[0][:100], rays[1][:100])
        assert launches == []
        with Tracer(build(mesh), device=session.info, layout="bvh8") as tracer:
            assert hits.t.tobytes() == tracer.closest_hit(rays[0][:100], rays[1][:100]).t.tobytes()
        assert (hits.instance_id[hits.is_hit] == 0).all()

    def test_not_for_those_who_compare_devices(self, session, mesh, rays, host_casts_few, launches):
        with Tracer(build(mesh), device=session.info, layout="bvh8") as tracer:
            with launch.device_casts_all():
                tracer.any_hit(rays[0][:3], rays[1][:3])
            tracer.any_hit(rays[0][:3], rays[1][:3])
        assert launches == ["any_hit"]

    def test_not_where_the_device_has_memory_of_its_own(
        self, session, mesh, rays, host_casts_few, launches, monkeypatch
    ):
        with Tracer(build(mesh), device=session.info, layout="bvh8") as tracer:
            own_memory = replace(session.info, kind="gpu")
            monkeypatch.setattr(tracer._caster.world.trees.session, "info", own_memory)
            tracer.closest_hit(rays[0][:3], rays[1][:3])
        assert launches == ["closest_hit"]


@pytest.mark.usefixtures("host_casts_few")
class TestCalls:
    @pytest.mark.parametrize(
        ("bad", "message"),
        [
            (([[0, 0, 0], [0, np.nan, 0]], [[0, 0, 1]]), r"origins\[1\] is not finite"),
            (([[0, 0, 0]], [[0, 0, 1], [0, np.inf, 1]]), r"directions\[1\] is not finite"),
            (([[0, 0, 0]] * 3, [[0, 0, 1], [1, 0, 0], [0, 0, 0]]), r"directions\[2\] has length zero"),
            (([1e308, 0, 0], [0, 0, 1]), "origins is too far"),
        ],
    )
    def test_bad_rays_are_named(self, session, bad, message, monkeypatch):
        small = Mesh.from_arrays(np.array(TRIANGLE[0]) * 1e-9, TRIANGLE[1])
        with Tracer(build(small), device=session.info, layout="bvh8") as tracer:
            errors = []
            for most in (launch.MOST_HOST_RAYS, 0):
                monkeypatch.setattr(launch, "MOST_HOST_RAYS", most)
                with pytest.raises(QueryError, match=message) as caught:
                    tracer.closest_hit(*bad)
                errors.append(str(caught.value))
            assert errors[0] == errors[1]

    def test_a_closed_tracer_says_so(self, session):
        tracer = Tracer(TRIANGLE, device=session.info, layout="bvh8")
        assert tracer.any_hit(*DOWN).all()
        tracer.close()
        with pytest.raises(QueryError, match="the tracer is closed"):
            tracer.any_hit(*DOWN)

    def test_a_forked_child_is_refused(self, session, monkeypatch):
        from clbvh.device.context import _OpenCL

        with Tracer(TRIANGLE, device=session.info, layout="bvh8") as tracer:
            tracer.any_hit(*DOWN)
            with monkeypatch.context() as patch:
                patch.setattr(_OpenCL, "is_inherited", True)
                with pytest.raises(DeviceError, match="forked"):
                    tracer.any_hit(*DOWN)

    def test_progress_is_told_once_and_may_close(self, session):
        tracer, told = Tracer(TRIANGLE, device=session.info, layout="bvh8"), []
        tracer.any_hit(*DOWN, progress=lambda done, all_rays: (told.append((done, all_rays)), tracer.close()))
        assert told == [(1, 1)]
        assert tracer.is_closed

    def test_the_time_counts_as_that_of_kernels(self, session):
        with Tracer(TRIANGLE, device=session.info, layout="bvh8") as tracer:
            tracer.closest_hit(*DOWN)
            before = tracer.timings_ms["kernel"]
            tracer.closest_hit(*DOWN)
            assert tracer.timings_ms["kernel"] > before > 0

    def test_updates_are_followed(self, session):
        """In both copies of the tree, each written while the host has seen it before."""
        # A triangle that stays: a mesh that moves as a whole keeps its tree.
        vertices = np.array([*TRIANGLE[0], [5, 5, 0], [6, 5, 0], [5, 6, 0]], np.float64)
        moves = np.array([[1, 0, 0]] * 3 + [[0, 0, 0]] * 3)
        mesh = Mesh.from_arrays(vertices, [[0, 1, 2], [3, 4, 5]])
        with Tracer(mesh, device=session.info, layout="bvh8") as tracer:
            for way in (0.0, 3.0, 0.0, 3.0, 3.0, 0.0):
                tracer.update(vertices + way * moves)
                assert tracer.any_hit(*DOWN).tolist() == [way == 0.0]
                assert tracer.closest_hit([[5.25, 5.25, 2]], DOWN[1]).t.tolist() == [2.0]

    def test_memory_is_given_back(self, session, mesh, rays):
        tracer = Tracer(build(mesh), device=session.info, layout="bvh8")
        tracer.closest_hit(rays[0][:3], rays[1][:3])
        held = tracer._caster.session._held
        assert len(held) == 2
        tracer.close()
        assert not held

    def test_threads_that_begin_together(self, session, mesh, rays):
        few = rays[0][:50], rays[1][:50]
        with Tracer(build(mesh), device=session.info, layout="bvh8") as tracer:
            expected = tracer.closest_prim(*few).tobytes()
        with Tracer(build(mesh), device=session.info, layout="bvh8") as tracer:
            barrier, found = threading.Barrier(6), []

            def work():
                barrier.wait()
                found.extend(tracer.closest_prim(*few).tobytes() for _ in range(20))

            threads = [threading.Thread(target=work) for _ in range(6)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            assert len(tracer._caster.session._held) == 2
        assert found == [expected] * 120
