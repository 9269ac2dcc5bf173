"""The order of rays: each is cast once, neighbours are close, and no answer depends on it."""

import numpy as np
import pytest

from clbvh import Tracer, build, make_shape
from clbvh.support.host_threads import HostThreads
from clbvh.trace import put_rays
from clbvh.trace.hits import all_hits as crossings_module
from clbvh.trace.rays import pieces
from clbvh.trace.rays.batch import read_rays
from clbvh.trace.rays.coherence import is_pencil, sort_rays
from clbvh.trace.world.tree_box import TreeBox

from ...profiles import seeds
from ...rays import aim, hard_rays

COUNT = 3 * pieces.LEAST_RAYS
CUBE = TreeBox(np.zeros(3), 1.0, np.ones(3))


def order_of(half, origins, directions, t_min=0.0, t_max=np.inf, *, centre=(0, 0, 0), threads=None, count_steps=None):
    box = TreeBox(np.asarray(centre, np.float64), 1.0, np.asarray(half, np.float64))
    batch, _ = read_rays(origins, directions, t_min, t_max)
    with HostThreads(threads) as opened:
        (piece,) = pieces.cut_rays(batch, box, opened, tile_rows=8, finds_pictures=False, count_steps=count_steps)
    assert piece.order is not None or not piece.is_coherent or count_steps is None
    return piece.order


def scattered(count, seed):
    """Rays from a sphere to points in the box from -1 to 1, in any order."""
    generator = np.random.default_rng(seed)
    origins = generator.normal(size=(count, 3))
    origins *= 4 / np.linalg.norm(origins, axis=1)[:, None]
    return aim(origins, generator.uniform(-1, 1, (count, 3)))


def picture(side):
    """Rays of a picture, row by row."""
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    targets = np.stack((x, y, np.zeros_like(x)), axis=-1).reshape(-1, 3)
    return aim(np.broadcast_to([0.0, 0.0, 5.0], targets.shape), targets)


def steps(places, order=slice(None)):
    return np.linalg.norm(np.diff(places[order], axis=0), axis=1).mean()


@pytest.mark.parametrize("seed", seeds(2))
def test_scattered_rays_are_sorted(seed):
    origins, directions = scattered(COUNT, seed)
    order = order_of([1, 1, 1], origins, directions)
    np.testing.assert_array_equal(np.sort(order), np.arange(COUNT))
    targets = origins + directions
    # About COUNT ** (1 / 4) = 15 rays lie along each of the four dimensions that rays have.
    assert steps(targets, order) < steps(targets) / 2
    assert steps(origins, order) < steps(origins) / 4


def test_a_shuffled_picture_is_sorted_and_a_picture_is_not():
    origins, directions = picture(512)
    assert order_of([1, 1, 1], origins, directions) is None
    shuffle = np.random.default_rng(3).permutation(len(origins))
    order = order_of([1, 1, 1], origins[shuffle], directions[shuffle])
    assert steps((origins + directions)[shuffle], order) < 0.1


def pencil(count, seed, kind):
    """Rays in any order from one point, outside of the box from -1 to 1 or inside, or in one direction."""
    generator = np.random.default_rng(seed)
    targets = generator.uniform(-1, 1, (count, 3))
    if kind == "parallel":
        return targets - 4 * np.array([0.3, 0.5, 0.8]), np.broadcast_to([0.3, 0.5, 0.8], targets.shape)
    origin = {"outside": [3.0, 1.0, 0.5], "inside": [0.1, 0.2, -0.3], "shared": [3.0, 1.0, 0.5]}[kind]
    return np.array(origin) if kind == "shared" else np.tile(origin, (count, 1)), targets - origin


@pytest.mark.parametrize("is_pencil", [False, True])
def test_rays_that_visit_few_nodes_stay_as_they_are(is_pencil):
    origins, directions = pencil(COUNT, 12, "outside") if is_pencil else scattered(COUNT, 12)
    samples = []

    def order(step_count):
        return order_of([1, 1, 1], origins, directions, count_steps=lambda sample: samples.append(sample) or step_count)

    assert order(1.0) is None
    assert order(10.0) is not None
    # Sorted, a pencil gets entry points as well.
    assert (order(2.5) is not None) == is_pencil
    sampled = samples[0].directions.items
    assert sampled.shape == (512, 3)
    assert (sampled[:, None] == directions[None, :1000]).all(axis=2).any()
    assert len(np.unique(sampled, axis=0)) == 512


def test_rays_at_a_small_tree_are_sorted_where_they_hit(session, monkeypatch):
    sorts, sort = [], pieces.sort_rays
    monkeypatch.setattr(pieces, "sort_rays", lambda *rest, **named: sorts.append(rest) or sort(*rest, **named))
    origins, directions = scattered(pieces.LEAST_RAYS, 13)
    with Tracer(build(make_shape("icosphere", triangles=2000)), device=session.info, layout="bvh8") as tracer:
        hits = tracer.closest_hit(origins, 4 * directions - 3 * np.roll(directions, 1, axis=1))
        assert sorts == []
        assert 0 < hits.is_hit.mean() < 0.5
        tracer.closest_hit(origins, directions)
        assert len(sorts) == 1
        # A large tree is not sampled, and neither is one that the host does not see.
        monkeypatch.setattr(put_rays, "MOST_SAMPLED_BYTES", 1)
        tracer.closest_hit(origins, 4 * directions - 3 * np.roll(directions, 1, axis=1))
        assert len(sorts) == 2
        monkeypatch.undo()


@pytest.mark.parametrize("kind", ["outside", "inside", "shared", "parallel"])
def test_rays_of_a_pencil_are_sorted_finely(kind):
    origins, directions = pencil(COUNT, 12, kind)
    assert is_pencil(read_rays(origins, directions, 0.0, np.inf)[0], 0, COUNT, CUBE)
    order = order_of([1, 1, 1], origins, directions)
    np.testing.assert_array_equal(np.sort(order), np.arange(COUNT))
    # Where they leave the box: two dimensions, so about COUNT ** (1 / 2) = 440 rays lie along each of them.
    with np.errstate(divide="ignore"):
        t = ((np.sign(directions) - origins) / directions).min(axis=1)
    assert steps(origins + t[:, None] * directions, order) < 0.02


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_a_pencil_is_one_at_every_size(scale):
    box = TreeBox(np.zeros(3), 2.0 ** -np.floor(np.log2(scale)), np.ones(3))
    for kind in ("outside", "parallel"):
        origins, directions = pencil(1000, 13, kind)
        assert is_pencil(read_rays(scale * origins, scale * directions, 0.0, np.inf)[0], 0, 1000, box)
    origins, directions = scattered(1000, 13)
    assert not is_pencil(read_rays(scale * origins, scale * directions, 0.0, np.inf)[0], 0, 1000, box)


def test_rays_that_are_not_valid_are_no_pencil():
    origins, directions = scattered(1000, 14)
    origins[::7], directions[1::7] = np.nan, 0.0
    assert not is_pencil(read_rays(origins, directions, 0.0, np.inf)[0], 0, 1000, CUBE)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_the_order_is_that_of_any_number_of_threads(threads):
    """And the same for rays that are far from where numbers are exact."""
    origins, directions = scattered(COUNT, 8)
    order = order_of([1, 1, 1], origins, directions, threads=threads)
    assert order.tobytes() == order_of([1, 1, 1], origins, directions, threads=3).tobytes()
    moved = order_of([1, 1, 1], origins + 2.0**20, directions, threads=threads, centre=[2.0**20] * 3)
    assert np.count_nonzero(moved != order) < COUNT / 100


def test_a_range_is_ordered_as_if_it_were_alone():
    origins, directions = scattered(COUNT, 9)
    batch, box = read_rays(origins, directions, 0.0, np.inf)[0], TreeBox(np.zeros(3), 1.0, np.ones(3))
    begin, end = 1000, 1000 + 2 * pieces.LEAST_RAYS
    with HostThreads() as threads:
        order = sort_rays(batch, begin, end, box, threads)
    assert order.tobytes() == order_of([1, 1, 1], origins[begin:end], directions[begin:end]).tobytes()


def test_rays_in_all_directions_are_sorted_unless_their_origins_are_in_order():
    generator = np.random.default_rng(10)
    origins = np.repeat(generator.uniform(-1, 1, (COUNT // 64 + 1, 3)), 64, axis=0)[:COUNT]
    directions = generator.normal(size=(COUNT, 3))
    assert order_of([1, 1, 1], origins, directions) is None
    assert order_of([1, 1, 1], generator.permutation(origins), directions) is not None
    assert order_of([1, 1, 1], np.zeros_like(origins), directions) is not None


def test_few_rays_stay_as_they_are():
    assert order_of([1, 1, 1], *scattered(pieces.LEAST_RAYS - 1, 0)) is None
    assert order_of([1, 1, 1], *scattered(pieces.LEAST_RAYS, 0)) is not None


def test_rays_that_meet_nothing_come_last():
    origins, directions = scattered(COUNT, 4)
    t_max = np.where(np.arange(COUNT) % 2, -1.0, np.inf)
    order = order_of([1, 1, 1], origins, directions, t_max=t_max)
    assert np.count_nonzero(np.diff(order % 2)) == 1
    assert order[-1] % 2 == 1


@pytest.mark.parametrize("half", [(1, 1, 0), (0, 0, 0), (1e-30, 1e30, 1)], ids=str)
@pytest.mark.parametrize("t_max", [np.inf, 1e-3, 0.0])
def test_boxes_and_rays_of_any_shape_are_no_error(half, t_max):
    origins, directions = scattered(COUNT, 5)
    directions[::3, 0], directions[1::3, 1:], origins[::5] = 0.0, 0.0, half
    directions[:, 2] = np.where((directions == 0).all(axis=1), 1.0, directions[:, 2])
    order = order_of(half, origins, directions, t_max=t_max)
    assert order is None or np.array_equal(np.sort(order), np.arange(COUNT))


def test_no_answer_depends_on_it(tracer, rays, monkeypatch):
    def answers():
        hits, crossings = tracer.closest_hit(*rays), tracer.all_hits(*rays, with_locations=True)
        arrays = [hits.t, hits.u, hits.v, hits.prim_id, crossings.t, crossings.prim_id, crossings.offsets]
        return [*arrays, crossings.locations, tracer.any_hit(*rays), tracer.count_hits(*rays), tracer.contains(rays[0])]

    # So that some rays are cast again, and some of these once more.
    monkeypatch.setattr(crossings_module, "FIRST_SLOTS", 1)
    monkeypatch.setattr(crossings_module, "SLOT_GROWTH", 2)
    expected = answers()
    orders = []
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    # And so that the sorted rays are cast in several pieces.
    monkeypatch.setattr(crossings_module, "MOST_SLOTS", 700)
    monkeypatch.setattr(pieces, "is_scattered", lambda *arguments: orders.append(arguments) or True)
    for obtained, given in zip(answers(), expected, strict=True):
        assert obtained.tobytes() == given.tobytes()
    assert len(orders) >= 5


def test_points_are_cast_after_rays_in_order(tracer, mesh, monkeypatch):
    points = hard_rays(mesh, 300, np.random.default_rng(6))[0]
    expected = tracer.closest_point(points)
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    tracer.closest_hit(*scattered(1000, 7))
    assert tracer.closest_point(points).prim_id.tobytes() == expected.prim_id.tobytes()


@pytest.mark.parametrize("query", ["closest_hit", "all_hits"])
def test_the_first_bad_ray_is_named_in_any_order(tracer, query):
    origins, directions = scattered(2 * pieces.LEAST_RAYS, 11)
    origins[[70000, 90000]], directions[80000] = np.nan, 0.0
    with pytest.raises(ValueError, match=r"origins\[70000\] is not finite"):
        getattr(tracer, query)(origins, directions)
