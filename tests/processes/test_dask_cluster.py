"""A cluster of real worker processes: the same bytes, also where a worker dies, and nothing left running."""

import os
import signal
import time

import dask.array as da
import joblib
import numpy as np
import pytest
import trimesh
from distributed import Client, LocalCluster, Nanny, Scheduler, SpecCluster

from clbvh import SceneRef, Tracer, choose_device, render_turntable
from clbvh.integrations.dask import closest_hit
from clbvh.support import opened
from tests.cli.command import refuses, run_clbvh

RAYS = np.random.default_rng(61).normal(size=(2, 4000, 3))


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    options = {"dashboard_address": None, "memory_limit": None, "local_directory": tmp_path_factory.mktemp("dask")}
    with LocalCluster(n_workers=2, threads_per_worker=1, **options) as cluster, Client(cluster) as client:
        yield client


@pytest.fixture
def ball(tmp_path):
    path = tmp_path / "ball.ply"
    trimesh.creation.icosphere(4).export(path)
    return path


def count_opened():
    """How many scenes a worker keeps open; it forgets them."""
    count = len(opened._kept)
    opened._kept.clear()
    return count


@pytest.mark.parametrize("given", ["reference", "tracer", "in memory"])
def test_workers_answer_as_a_tracer_here_and_open_it_once(session, client, ball, given):
    client.run(count_opened)
    with SceneRef(ball).tracer() as tracer:
        expected = tracer.closest_hit(*RAYS)
        if given == "tracer":
            tracer.update(tracer.mesh.vertices * 1.5)
            expected = tracer.closest_hit(*RAYS)
        source = {"reference": ball, "tracer": tracer, "in memory": tracer.mesh}[given]
        hits = closest_hit(source, *(da.from_array(each, chunks=(100, 3)) for each in RAYS))
        for name, found in hits.items():
            assert found.compute().tobytes() == getattr(expected, name).tobytes(), name
    assert set(client.run(count_opened).values()) <= {0, 1}


def cast_here(ref, rays, **options):
    """The device of the process, and the hits that it finds."""
    tracer = ref.tracer(**options)
    hits = tracer.closest_hit(*rays)
    return tracer.device.name, [each.tobytes() for each in (hits.t, hits.u, hits.v, hits.prim_id)]


@pytest.mark.on_opencl
def test_workers_with_a_device_each_answer_as_one_tracer(session, ball, tmp_path):
    names = {"host": choose_device("host").name, "pocl": choose_device("pocl").name}
    common = {"nthreads": 1, "dashboard": False, "local_directory": str(tmp_path)}
    workers = {each: {"cls": Nanny, "options": {**common, "env": {"CLBVH_DEVICE": each}}} for each in names}
    scheduler = {"cls": Scheduler, "options": {"dashboard": False, "dashboard_address": ":0"}}
    with Tracer(ball, device="host") as one, SpecCluster(workers, scheduler) as cluster, Client(cluster) as client:
        hits, ref = one.closest_hit(*RAYS), SceneRef(ball)
        # Chosen by the environment of the worker, or by the task.
        cases = [("host", {}, "host"), ("pocl", {}, "pocl"), ("pocl", {"device": "host"}, "host")]
        for part, (worker, options, device) in zip(np.array_split(np.arange(len(RAYS[0])), 3), cases, strict=True):
            answer = client.submit(cast_here, ref, RAYS[:, part], workers=[worker], **options).result(timeout=120)
            expected = [each[part].tobytes() for each in (hits.t, hits.u, hits.v, hits.prim_id)]
            assert answer == (names[device], expected)
        shared = closest_hit(ball, *(da.from_array(each, chunks=(100, 3)) for each in RAYS))
        assert client.compute(shared["t"]).result(timeout=120).tobytes() == hits.t.tobytes()


def wait_a_little(block):
    time.sleep(0.05)
    return block


def test_a_worker_that_is_killed_in_the_middle_changes_no_byte(session, client, ball):
    with SceneRef(ball).tracer() as tracer:
        expected = tracer.closest_hit(*RAYS).t
    origins = da.from_array(RAYS[0], chunks=(50, 3)).map_blocks(wait_a_little, dtype=float)
    victim = next(iter(client.run(os.getpid).values()))
    future = client.compute(closest_hit(ball, origins, da.from_array(RAYS[1], chunks=(50, 3)))["t"])
    time.sleep(1.0)
    assert not future.done()
    os.kill(victim, signal.SIGKILL)
    assert future.result(timeout=120).tobytes() == expected.tobytes()


def count_hits(ref, tracer, height):
    return [each.closest_hit(RAYS[0] + [0, 0, height], RAYS[1]).count for each in (ref.tracer(), tracer)]


def test_joblib_takes_references_and_tracers(session, ball):
    ref, heights = SceneRef(ball), (0.0, 0.5)
    with ref.tracer() as tracer:
        answers = joblib.Parallel(2)(joblib.delayed(count_hits)(ref, tracer, height) for height in heights)
        joblib.externals.loky.get_reusable_executor().shutdown()
        assert answers == [count_hits(ref, tracer, height) for height in heights]


def test_a_film_of_a_cluster_is_that_of_this_process(session, client, ball, tmp_path):
    there, here = tmp_path / "there.gif", tmp_path / "here.gif"
    words = ("--frames", 3, "--width", 48, "--height", 32, "--shading", "lambert")
    address = client.scheduler.address
    answer = run_clbvh("turntable", ball, "-o", there, *words, "--cluster", address)
    assert answer.returncode == 0, answer.stderr
    render_turntable(ball, here, width=48, height=32, shading="lambert", frames=3)
    assert there.read_bytes() == here.read_bytes()


def test_a_cluster_that_is_not_there_is_one_line(session, ball, tmp_path, monkeypatch):
    monkeypatch.setattr("clbvh.cli.turntable._PATIENCE_S", 1)
    words = ("turntable", ball, "-o", tmp_path / "a.gif", "--width", 48, "--height", 32)
    refuses(run_clbvh(*words, "--cluster", "tcp://127.0.0.1:9"), 2, "no scheduler of a Dask cluster")
    refuses(run_clbvh(*words, "--cluster", "nowhere://"), 2, "no scheduler of a Dask cluster")
    assert not (tmp_path / "a.gif").exists()
