"""An engine in its process: measured, refused, killed, and gone when it is closed."""

from __future__ import annotations

import multiprocessing

import numpy as np
import pytest

from clbvh import make_shape
from clbvh.study.engines import ENGINES, Engine, EngineError, Rival, open_engine
from clbvh.study.experiments.peers import QUERIES

RAY_COUNT = 64
RAYS = ("coherent", "shuffled", "scattered")


class Slow(Engine):
    """Counts what it is given, and no more than a few of them."""

    most_items = 10

    def __init__(self, vertices, faces):
        self.built = 0

    def build(self):
        self.built += 1

    def closest(self, rays):
        assert rays[0].flags.c_contiguous
        return len(rays[0])

    def points(self, points):
        return len(points[0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The shared files of a small mesh."""
    folder = tmp_path_factory.mktemp("shared")
    mesh = make_shape("knot", triangles=500)
    generator = np.random.default_rng(0)
    origins = np.tile([[0.0, 0.0, 9.0]], (RAY_COUNT, 1))
    directions = generator.normal(size=(RAY_COUNT, 3)) * [0.1, 0.1, 0.0] - [0, 0, 1]
    arrays = {"vertices": mesh.vertices, "faces": mesh.faces, "points": origins[None]}
    arrays |= dict.fromkeys(("coherent", "shuffled", "scattered"), np.stack((origins, directions)))
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
    return str(folder)


def test_a_slow_engine_gets_an_even_share(folder, monkeypatch):
    monkeypatch.setitem(ENGINES, "slow", Slow)
    tasks = open_engine("slow", folder)
    assert [query for query in QUERIES if Slow.has(query)] == list(tasks) == ["build", *RAYS, "points"]
    for query in (*RAYS, "points"):
        # Every seventh of 64.
        assert tasks[query]() == (10, 10)
    assert tasks["build"]() == (len(np.load(f"{folder}/faces.npy")), None)


@pytest.mark.usefixtures("_opened_device")
def test_this_library_in_a_process_of_its_own(folder):
    with Rival("clbvh", folder) as engine:
        for query in QUERIES:
            assert engine.measure(query)[0] > 0
        (_, closest), (_, every) = (engine.measure(query)[1] for query in ("coherent", "all"))
        assert 0 < closest <= every
        # It survives a question that it does not understand.
        with pytest.raises(EngineError, match="the engine fails: KeyError"):
            engine.measure("no such query")
        assert engine.measure("any")[1] == (RAY_COUNT, closest)
        engine._process.kill()
        with pytest.raises(EngineError, match="the engine's process died"):
            engine.measure("any")
    assert engine._process not in multiprocessing.active_children()


def test_an_engine_that_cannot_be_opened_is_an_error(folder):
    with Rival("nobody", folder) as engine, pytest.raises(EngineError, match="the engine fails: KeyError"):
        engine.measure("build")
    assert engine._process not in multiprocessing.active_children()
