"""An engine in its process: measured, refused, killed, and gone when it is closed."""

from __future__ import annotations

import multiprocessing

import numpy as np
import pytest

from clbvh import make_shape
from clbvh.study.engines import ENGINES, Contestant, Engine
from clbvh.study.rival import EngineError, Rival

RAYS = 64


class Slow(Engine):
    """Counts what it is given, and no more than a few of them."""

    name = "slow"
    queries = ("coherent", "points")
    most_items = 10

    def open(self, vertices, faces):
        self.built = 0

    def build(self):
        self.built += 1

    def prepare(self, query, *arrays):
        return lambda: len(arrays[0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The shared files of a small mesh."""
    folder = tmp_path_factory.mktemp("shared")
    mesh = make_shape("knot", triangles=500)
    generator = np.random.default_rng(0)
    origins = np.tile([[0.0, 0.0, 9.0]], (RAYS, 1))
    directions = generator.normal(size=(RAYS, 3)) * [0.1, 0.1, 0.0] - [0, 0, 1]
    arrays = {"vertices": mesh.vertices, "faces": mesh.faces, "points": origins}
    for order in ("coherent", "shuffled", "scattered"):
        arrays |= {f"{order}-origins": origins, f"{order}-directions": directions}
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
    return str(folder)


def test_a_slow_engine_gets_an_even_share(folder, monkeypatch):
    monkeypatch.setitem(ENGINES, "slow", Slow)
    contestant = Contestant("slow", folder)
    for query in ("coherent", "points"):
        values = contestant.answer(query)
        # Every seventh of 64.
        assert values["items"] == values["answers"] == 10
        assert values["wall_ms"] >= 0
    assert contestant.answer("build")["items"] == len(np.load(f"{folder}/faces.npy"))
    assert contestant._engine.built == 2


@pytest.mark.usefixtures("_opened_device")
def test_this_library_in_a_process_of_its_own(folder):
    with Rival("clbvh", Contestant, "clbvh", folder) as engine:
        for query in ENGINES["clbvh"].queries:
            values = engine.ask(query)
            assert values["wall_ms"] > 0
            if query != "build":
                assert values["kernel_ms"] > 0
        closest, every = (engine.ask(query)["answers"] for query in ("coherent", "all"))
        assert 0 < closest <= every
        # It survives a question that it does not understand.
        with pytest.raises(EngineError, match="clbvh fails: FileNotFoundError"):
            engine.ask("no such query")
        assert engine.ask("any")["answers"] == closest
        engine._process.kill()
        with pytest.raises(EngineError, match="the process of clbvh died"):
            engine.ask("any")
    assert not [child for child in multiprocessing.active_children() if child.name.startswith("clbvh-clbvh")]


def test_an_engine_that_cannot_be_opened_is_an_error(folder):
    with pytest.raises(EngineError, match="nobody fails: KeyError"):
        Rival("nobody", Contestant, "nobody", folder)
    assert not [child for child in multiprocessing.active_children() if "nobody" in child.name]
