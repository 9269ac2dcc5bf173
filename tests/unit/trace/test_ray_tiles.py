"""A picture's rays in an array are traced tile by tile, and no answer depends on it."""

import numpy as np
import pytest

from clbvh import Tracer, build
from clbvh.device.session import DeviceSession
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.rendering.cameras.framing import frame_mesh
from clbvh.trace.rays import pieces

from ...rays import random_rays

WIDTH, HEIGHT = 150, 97  # no multiples of a tile's


@pytest.fixture(scope="module")
def picture():
    mesh = make_shape("knot", triangles=2000)
    origins, directions = frame_mesh(mesh, aspect=WIDTH / HEIGHT).rays(WIDTH, HEIGHT)
    return mesh, origins.reshape(-1, 3)[: -WIDTH // 3], directions.reshape(-1, 3)[: -WIDTH // 3]


@pytest.fixture(scope="module")
def wide_tracer(_opened_device, picture):
    with Tracer(build(picture[0]), device=_opened_device.info, layout="bvh8") as opened:
        yield opened


@pytest.fixture
def launches(monkeypatch):
    """What is launched from now on: name, work-items and work-group."""
    launched, run = [], DeviceSession.run

    def record(session, kernel, size, group, **arguments):
        launched.append((kernel.name, size, group))
        run(session, kernel, size, group, **arguments)

    monkeypatch.setattr(DeviceSession, "run", record)
    return launched


def ask(tracer, origins, directions):
    """All answers, as bytes."""
    hits, crossings = tracer.closest_hit(origins, directions), tracer.all_hits(origins, directions)
    answers = [hits.t, hits.u, hits.v, hits.prim_id, crossings.t, crossings.prim_id, crossings.offsets]
    answers += [tracer.any_hit(origins, directions), tracer.count_hits(origins, directions)]
    return [answer.tobytes() for answer in answers]


@pytest.fixture(scope="module")
def expected(wide_tracer, picture):
    # So few rays are taken as one row, from the root.
    assert len(picture[1]) < pieces.LEAST_RAYS
    assert 0.1 < wide_tracer.any_hit(*picture[1:]).mean() < 0.9
    return ask(wide_tracer, *picture[1:])


@pytest.mark.parametrize("chunk", [2**20, 8 * WIDTH, 8 * WIDTH - 1, 5000, 1000])
def test_chunks_of_whole_tiles(wide_tracer, picture, expected, launches, monkeypatch, chunk):
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    monkeypatch.setattr(pieces, "CHUNK_RAYS", chunk)
    assert ask(wide_tracer, *picture[1:]) == expected
    closest = [(size, group) for name, size, group in launches if name == "closest_hit"]
    if chunk < 8 * WIDTH:
        # A row of tiles does not fit: one row of rays.
        assert {group for _, group in closest} == {(32, 1)}
    else:
        assert {group for _, group in closest} == {(8, 8)}
        assert all(size[0] == WIDTH and size[0] * size[1] <= chunk for size, _ in closest)
        assert all(size[1] % 8 == 0 for size, _ in closest[:-1])
        assert sum(size[1] for size, _ in closest) == HEIGHT
    entries = [name for name, _, _ in launches].count("tile_entry_points")
    assert entries >= len(closest)


def test_the_shape_of_a_picture_is_not_guessed(wide_tracer, picture, expected, launches, monkeypatch):
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    monkeypatch.setattr(pieces, "find_row_length", None)  # nobody asks
    rows = len(picture[1]) // WIDTH
    origins, directions = (rays[: rows * WIDTH].reshape(rows, WIDTH, 3) for rays in picture[1:])
    hits = wide_tracer.closest_hit(origins, directions)
    assert hits.t.tobytes() == expected[0][: hits.t.nbytes]
    assert launches[-1] == ("closest_hit", (WIDTH, rows), (8, 8))


def test_an_array_with_the_shape_of_a_picture_may_be_scattered(wide_tracer, picture, launches, monkeypatch):
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    order = np.random.default_rng(41).permutation(64 * 128)
    origins, directions = (rays[order] for rays in picture[1:])
    hits = wide_tracer.closest_hit(origins.reshape(64, 128, 3), directions.reshape(64, 128, 3))
    assert hits.t.tobytes() == wide_tracer.closest_hit(origins, directions).t.tobytes()
    # Neither is cast in tiles of a picture.
    assert [launched for launched in launches if launched[0] == "closest_hit"] == [
        ("closest_hit", (len(order), 1), (32, 1))
    ] * 2


def test_shuffled_rays_of_one_camera_have_entries_again(wide_tracer, picture, expected, launches, monkeypatch):
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    order = np.random.default_rng(40).permutation(len(picture[1]))
    shuffled = ask(wide_tracer, picture[1][order], picture[2][order])
    back = np.empty(len(order))
    back[order] = np.frombuffer(shuffled[0])
    assert back.tobytes() == expected[0]
    names = [name for name, _, _ in launches]
    assert names[:2] == ["tile_entry_points", "closest_hit"]
    monkeypatch.setattr(pieces, "is_scattered", lambda *arguments: False)
    assert shuffled == ask(wide_tracer, picture[1][order], picture[2][order])


def test_rays_in_no_order_have_no_entries(wide_tracer, picture, launches, monkeypatch):
    rays = random_rays(picture[0], 5000, np.random.default_rng(42))
    expected = ask(wide_tracer, *rays)
    launches.clear()
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    assert ask(wide_tracer, *rays) == expected
    assert {name for name, _, _ in launches} == {"closest_hit", "any_hit", "count_hits", "first_hits"}


def test_few_rays_have_no_entries(wide_tracer, picture, expected, launches):
    assert ask(wide_tracer, *picture[1:]) == expected
    assert "tile_entry_points" not in {name for name, _, _ in launches}


def test_a_layout_without_entries(session, picture, expected, monkeypatch):
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    with Tracer(build(picture[0]), device=session.info, layout="bvh2") as narrow:
        assert ask(narrow, *picture[1:]) == expected
