"""The order in which rays are cast: neighbours are close, pictures go tile by tile, and no answer depends on it."""

from functools import partial

import numpy as np
import pytest

from clbvh import Tracer, make_shape
from clbvh.trace import put_rays
from clbvh.trace.hits import all_hits as all_hits_module, search
from clbvh.trace.rays import pieces
from clbvh.trace.rays.batch import read_rays
from clbvh.trace.rays.coherence import sort_rays
from clbvh.trace.world.tree_box import TreeBox
from clbvh.views.cameras.framing import frame_mesh

from ...rays import aim, order_by_keys, random_rays

COUNT = 3 * pieces.LEAST_RAYS
WIDTH, HEIGHT = 150, 97  # no multiples of a tile's


def cube(scale=1.0):
    return TreeBox(np.zeros(3), scale, np.ones(3))


def order_of(origins, directions, t_max=np.inf, *, box=None, order=order_by_keys, count_steps=None):
    batch, box = read_rays(origins, directions, 0.0, t_max), box or cube()
    (piece,) = pieces.cut_rays(batch, box, order, tile_rows=8, finds_pictures=False, count_steps=count_steps)
    return piece.order


def rays_in_no_order(kind, seed=12, count=COUNT):
    """Rays at points in the box from -1 to 1: from a sphere around it, from one point, or in one direction."""
    generator = np.random.default_rng(seed)
    targets = generator.uniform(-1, 1, (count, 3))
    if kind == "scattered":
        origins = generator.normal(size=(count, 3))
        return aim(origins * 4 / np.linalg.norm(origins, axis=1)[:, None], targets)
    if kind == "parallel":
        return targets - 4 * np.array([0.3, 0.5, 0.8]), np.broadcast_to([0.3, 0.5, 0.8], targets.shape)
    origin = np.array([0.1, 0.2, -0.3] if kind == "inside" else [3.0, 1.0, 0.5])
    return origin if kind == "shared" else np.tile(origin, (count, 1)), targets - origin


def mean_step(places, order=slice(None)):
    return np.linalg.norm(np.diff(places[order], axis=0), axis=1).mean()


def test_scattered_rays_are_sorted(tracer):
    origins, directions = rays_in_no_order("scattered")
    order, targets = order_of(origins, directions), origins + directions
    np.testing.assert_array_equal(np.sort(order), np.arange(COUNT))
    # About COUNT ** (1 / 4) = 15 rays lie along each of the four dimensions that rays have.
    assert mean_step(targets, order) < mean_step(targets) / 2
    assert mean_step(origins, order) < mean_step(origins) / 4
    # The same in any parts, by the device, and as a part of more rays.
    assert order_of(origins, directions, order=partial(order_by_keys, parts=5)).tobytes() == order.tobytes()
    with tracer._caster.open_call() as call:
        assert order_of(origins, directions, order=call.order_by_keys).tobytes() == order.tobytes()
    begin, end = 1000, 1000 + 2 * pieces.LEAST_RAYS
    of_part = sort_rays(read_rays(origins, directions, 0.0, np.inf), begin, end, cube(), order_by_keys)
    assert of_part.tobytes() == order_of(origins[begin:end], directions[begin:end]).tobytes()

    # Those that meet nothing come last.
    order = order_of(origins, directions, np.where(np.arange(COUNT) % 2, -1.0, np.inf))
    np.testing.assert_array_equal(order % 2, np.arange(COUNT) >= (COUNT + 1) // 2)


@pytest.mark.parametrize("kind", ["outside", "inside", "shared", "parallel"])
def test_rays_of_a_pencil_are_sorted_finely(kind):
    origins, directions = rays_in_no_order(kind)
    order = order_of(origins, directions)
    np.testing.assert_array_equal(np.sort(order), np.arange(COUNT))
    # Where they leave the box: two dimensions, so about COUNT ** (1 / 2) = 440 rays lie along each of them.
    with np.errstate(divide="ignore"):
        t = ((np.sign(directions) - origins) / directions).min(axis=1)
    assert mean_step(origins + t[:, None] * directions, order) < 0.02
    scaled = order_of(origins * 2.0**100, directions * 2.0**100, box=cube(scale=2.0**-100))
    assert scaled.tobytes() == order.tobytes()


def test_rays_stay_as_they_are_where_sorting_does_not_pay():
    scattered, pencil = rays_in_no_order("scattered"), rays_in_no_order("outside")
    assert order_of(*(part[: pieces.LEAST_RAYS - 1] for part in scattered)) is None
    assert order_of(*(part[: pieces.LEAST_RAYS] for part in scattered)) is not None
    x, y = np.meshgrid(np.linspace(-1, 1, 512), np.linspace(-1, 1, 512))
    targets = np.stack((x, y, np.zeros_like(x)), axis=-1).reshape(-1, 3)
    origins, directions = aim(np.broadcast_to([0.0, 0.0, 5.0], targets.shape), targets)
    assert order_of(origins, directions) is None
    shuffle = np.random.default_rng(3).permutation(len(targets))
    assert mean_step(targets[shuffle], order_of(origins[shuffle], directions[shuffle])) < 0.1
    # Rays in all directions, whose origins are in order, or not.
    generator = np.random.default_rng(10)
    origins = np.repeat(generator.uniform(-1, 1, (COUNT // 64 + 1, 3)), 64, axis=0)[:COUNT]
    directions = generator.normal(size=(COUNT, 3))
    assert order_of(origins, directions) is None
    assert order_of(generator.permutation(origins), directions) is not None
    # Rays that visit few nodes; sorted, a pencil gets entry points as well.
    for steps, rays, is_sorted in ((1.0, scattered, False), (10.0, scattered, True), (2.5, scattered, False),
                                   (1.0, pencil, False), (10.0, pencil, True), (2.5, pencil, True)):  # fmt: skip
        order = order_of(*rays, count_steps=lambda sample, steps=steps: steps * (sample.ray_count == 512))
        assert (order is not None) == is_sorted, steps


def test_rays_at_a_small_tree_are_sorted_where_they_hit(session, monkeypatch):
    sorts, sort = [], pieces.sort_rays
    monkeypatch.setattr(pieces, "sort_rays", lambda *rest, **named: sorts.append(rest) or sort(*rest, **named))
    origins, directions = rays_in_no_order("scattered", count=pieces.LEAST_RAYS)
    past = 4 * directions - 3 * np.roll(directions, 1, axis=1)
    with Tracer(make_shape("icosphere", triangles=2000), device=session.info, layout="bvh8") as tracer:
        assert 0 < tracer.closest_hit(origins, past).is_hit.mean() < 0.5
        assert len(sorts) == 0
        tracer.closest_hit(origins, directions)
        assert len(sorts) == 1
        # A large tree is not sampled, and neither is one that the host does not see.
        monkeypatch.setattr(put_rays, "MOST_SAMPLED_BYTES", 1)
        tracer.closest_hit(origins, past)
        assert len(sorts) == 2


def ask(tracer, rays):
    """All answers, as bytes."""
    hits, crossings = tracer.closest_hit(*rays), tracer.all_hits(*rays, with_locations=True)
    answers = [hits.t, hits.u, hits.v, hits.prim_id, crossings.t, crossings.prim_id, crossings.offsets]
    answers += [crossings.locations, tracer.any_hit(*rays), tracer.count_hits(*rays), tracer.contains(rays[0])]
    return [answer.tobytes() for answer in answers]


def test_no_answer_depends_on_it(tracer, rays, monkeypatch):
    # So that some rays are cast again, and some of these once more.
    monkeypatch.setattr(all_hits_module, "FIRST_SLOTS", 1)
    monkeypatch.setattr(all_hits_module, "SLOT_GROWTH", 2)
    expected, orders = ask(tracer, rays), []
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    # And so that the sorted rays are cast in several pieces, the last one of one ray.
    monkeypatch.setattr(pieces, "CHUNK_RAYS", len(rays[0]) - 1)
    monkeypatch.setattr(search, "MOST_SLOTS", 700)
    monkeypatch.setattr(pieces, "is_scattered", lambda *arguments: orders.append(arguments) or True)
    assert ask(tracer, rays) == expected
    assert len(orders) >= 5


@pytest.fixture(scope="module")
def wide(open_tracer, mesh):
    return open_tracer(mesh, layout="bvh8")


@pytest.fixture(scope="module")
def picture(wide):
    """The rays of a picture row by row, without the end of the last row."""
    rays = frame_mesh(wide.mesh, aspect=WIDTH / HEIGHT).rays(WIDTH, HEIGHT)
    return tuple(part.reshape(-1, 3)[: -WIDTH // 3] for part in rays)


@pytest.fixture(scope="module")
def expected(wide, picture):
    # So few rays are taken as one row, from the root.
    assert len(picture[0]) < pieces.LEAST_RAYS
    assert 0.1 < wide.any_hit(*picture).mean() < 0.9
    return ask(wide, picture)


@pytest.fixture
def cast(monkeypatch):
    """The pieces that are cast from now on, query by query; no batch has too few rays for an order."""
    queries, cut = [], put_rays.cut_rays

    def record(*arguments, **options):
        queries.append([])
        for piece in cut(*arguments, **options):
            queries[-1].append(piece)
            yield piece

    monkeypatch.setattr(put_rays, "cut_rays", record)
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    return queries


@pytest.mark.parametrize("chunk", [2**20, 8 * WIDTH, 8 * WIDTH - 1, 5000, 1000])
def test_a_picture_is_cast_in_chunks_of_whole_tiles(wide, picture, expected, cast, monkeypatch, chunk):
    monkeypatch.setattr(pieces, "CHUNK_RAYS", chunk)
    assert ask(wide, picture) == expected
    closest = cast[0]
    # A row of tiles may not fit: then it is one row of rays.
    assert {piece.row_length for piece in closest} == {None if chunk < 8 * WIDTH else WIDTH}
    counts = [piece.item_count for piece in closest]
    assert max(counts) <= chunk
    assert sum(counts) == len(picture[0])
    if chunk >= 8 * WIDTH:
        assert all(count % (8 * WIDTH) == 0 for count in counts[:-1])
    assert all(piece.is_coherent for piece in closest)


def test_the_shape_of_a_picture_is_not_guessed_but_may_lie(wide, picture, expected, cast, monkeypatch):
    monkeypatch.setattr(pieces, "find_row_length", None)  # nobody asks
    rows = len(picture[0]) // WIDTH
    hits = wide.closest_hit(*(part[: rows * WIDTH].reshape(rows, WIDTH, 3) for part in picture))
    assert hits.t.tobytes() == expected[0][: hits.t.nbytes]
    assert [(piece.item_count, piece.row_length) for piece in cast[-1]] == [(rows * WIDTH, WIDTH)]
    scattered = [part[np.random.default_rng(41).permutation(64 * 128)].reshape(64, 128, 3) for part in picture]
    wide.closest_hit(*scattered)
    assert [(piece.item_count, piece.row_length) for piece in cast[-1]] == [(64 * 128, None)]


def test_shuffled_rays_have_entries_if_they_are_of_one_camera(wide, picture, expected, cast):
    order = np.random.default_rng(40).permutation(len(picture[0]))
    shuffled = wide.closest_hit(*(part[order] for part in picture))
    assert shuffled.t.tobytes() == np.frombuffer(expected[0])[order].tobytes()
    assert [(piece.order is not None, piece.is_coherent) for piece in cast[-1]] == [(True, True)]
    cast.clear()
    ask(wide, random_rays(wide.mesh, 5000, np.random.default_rng(42)))
    assert not any(piece.is_coherent for query in cast for piece in query)
