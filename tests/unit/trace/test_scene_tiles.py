"""Pictures among rays: their rows are found, and rays that begin where their tile's beam leads them hit the same."""

from unittest.mock import patch

import numpy as np
import pytest

from clbvh import Mesh, Tracer, make_shape
from clbvh.structs import TILE
from clbvh.trace import put_rays
from clbvh.trace.host_items import HostItems
from clbvh.trace.rays import pieces
from clbvh.trace.rays.batch import read_rays
from clbvh.trace.rays.coherence import find_row_length
from clbvh.trace.world.world import World
from clbvh.tree_layouts import WIDE_LAYOUTS
from clbvh.views.cameras.framing import frame_mesh

from ...profiles import seeds
from ...property.random_scenes import KINDS, LINEAR, RAY_MASKS, make_scene, scale_scene
from .scene_states import affine, make_state, random_linear, scene_of, turn

WIDTH, HEIGHT = 75, 44  # no multiples of a tile's

NO_LIST, NO_INSTANCE = -1, -1


def row_length(origins, directions):
    return find_row_length(read_rays(origins.reshape(-1, 3), directions.reshape(-1, 3), 0.0, np.inf))


def test_rows_of_pictures_are_found_and_nothing_else_is_a_picture():
    ball = make_shape("icosphere", triangles=80)
    for width, height in ((1920, 1080), (64, 64), (1155, 866), (33, 40), (320, 200)):
        picture = frame_mesh(ball, aspect=width / height).rays(width, height)
        for dtype in (np.float32, np.float64):
            assert row_length(*(part.astype(dtype) for part in picture)) == width
    assert row_length(*(np.repeat(part, 4, axis=1) for part in picture)) == 4 * 320
    assert row_length(*(part.swapaxes(0, 1) for part in picture)) == 200
    origins, directions = (part.reshape(-1, 3) for part in picture)
    assert row_length(origins[:-123], directions[:-123]) == 320
    jitter = np.random.default_rng(1).uniform(-0.5, 0.5, directions.shape) * np.abs(directions[1] - directions[0])
    assert row_length(origins, directions + jitter) == 320
    # Rows of a scan all around have no ends.
    turns, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 720, endpoint=False), np.linspace(-1.55, 1.55, 360))
    scan = np.stack((np.cos(turns) * np.cos(rise), np.sin(turns) * np.cos(rise), np.sin(rise)), axis=-1)
    assert row_length(np.zeros_like(scan), scan) == 720

    # No two rows of a disc are equally long.
    x, y = np.meshgrid(np.linspace(-1, 1, 320), np.linspace(-1, 1, 200))
    for chosen in (np.random.default_rng(2).permutation(len(origins)), slice(320), (x**2 + y**2 < 1).reshape(-1)):
        assert row_length(origins[chosen], directions[chosen]) is None
    for count in (0, 1, 31, 512, 5000):
        for value in (np.nan, np.inf, 0.0, 1.0):
            assert row_length(np.full((count, 3), value), np.full((count, 3), value)) is None


@pytest.fixture
def tiles(session, monkeypatch):
    """The tiles that are found from now on, launch by launch; the few rays of a test are taken for a picture's.

    The host's kernel has them to itself: there is nothing in its launches.
    """
    found, find, cast = [], put_rays.find_entry_points, HostItems.run

    def record_on_host(rays, *arguments):
        *_, finds_start, _, _, _ = rays.numbers
        found.extend([np.empty(0, TILE)] * finds_start)
        cast(rays, *arguments)

    monkeypatch.setattr(HostItems, "run", record_on_host)

    def record(session, world, kernel, take, work_size, tile, **arguments):
        starts = find(session, world, kernel, take, work_size, tile, **arguments)
        columns, rows = (-(-length // edge) for length, edge in zip(work_size, tile, strict=True))
        with session.mapped(starts["tiles"], columns * rows, TILE, write=False) as items:
            found.append(items.copy())
        return starts

    monkeypatch.setattr(put_rays, "find_entry_points", record)
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    monkeypatch.setattr(pieces, "is_scattered", lambda *arguments: False)
    return found


def look(eye, towards, width, *, is_parallel=False):
    """Rays of a square picture of this width at the distance of `towards`: (HEIGHT, WIDTH, 3) each."""
    way = np.asarray(towards, np.float64) - eye
    axes = np.linalg.svd(way[None] / np.linalg.norm(way))[2]
    x, y = np.meshgrid(np.linspace(-1, 1, WIDTH), np.linspace(-1, 1, HEIGHT))
    across = width / 2 * (x[..., None] * axes[1] + y[..., None] * axes[2])
    if is_parallel:
        return eye + across, np.broadcast_to(way, across.shape)
    return np.broadcast_to(np.asarray(eye, np.float64), across.shape), way + across


def ask(tracer, origins, directions, **limits):
    """All answers, as bytes, and the closest hits."""
    closest = tracer.closest_hit(origins, directions, **limits)
    crossings = tracer.all_hits(origins, directions, **limits)
    arrays = [
        *(getattr(hits, name) for hits in (closest, crossings) for name in ("t", "u", "v", "prim_id", "instance_id")),
        crossings.offsets, tracer.any_hit(origins, directions, **limits),
        tracer.count_hits(origins, directions, **limits), closest.locations,
    ]  # fmt: skip
    return [np.asarray(array).tobytes() for array in arrays], closest


def check(session, state, asked, tiles):
    """Ask with and without entry points, in all layouts that have them; return the closest hits, and all tiles.

    `asked` yields rays and limits, given the tracer.
    """
    answers = []
    for layout in WIDE_LAYOUTS:
        with Tracer(scene_of(state), device=session.info, layout=layout) as tracer:
            for has_entry_points in (True, False):
                before = len(tiles)
                with patch.object(World, "has_entry_points", has_entry_points):
                    answers.append([ask(tracer, *rays, **limits) for rays, limits in asked(tracer)])
                assert (len(tiles) > before) == has_entry_points
    for others in answers[1:]:
        assert [bits for bits, _ in others] == [bits for bits, _ in answers[0]]
    return np.concatenate([closest.is_hit.reshape(-1) for _, closest in answers[0]]), np.concatenate(tiles)


def random_views(state, generator):
    """Pictures of a random scene: of all of it, of an instance, along an axis, from within."""
    chosen = generator.integers(0, len(state.transforms))
    linear, target = state.transforms[chosen, :3, :3], state.transforms[chosen, :3, 3]
    size, way = 8 * np.linalg.norm(linear, 2), generator.normal(size=3)
    way *= size / np.linalg.norm(way)
    yield look(target - 2 * way, target, 2 * size)
    yield look(target - 50 * way, target, size)
    yield look(target - 2e4 * way, target, size)
    yield look(target, target + way, 3 * size)
    yield look(target - 3 * size * np.eye(3)[generator.integers(0, 3)], target, size, is_parallel=True)


@pytest.mark.on_both
@pytest.mark.parametrize(("scale", "is_far"), [(1.0, False), (1.0, True), (1e-30, True), (1e30, False)])
@pytest.mark.parametrize("seed", seeds(2))
def test_random_scenes(session, tiles, seed, is_far, scale):
    state = scale_scene(make_scene(seed, tuple(KINDS), tuple(LINEAR), is_far=is_far), scale).state

    def asked(tracer):
        generator = np.random.default_rng([seed, 77])
        for rays in random_views(state, generator):
            yield rays, {}
            first = tracer.closest_hit(*rays)
            t, shape = np.where(first.is_hit, first.t, 1.0), first.t.shape
            t_min = np.where(generator.random(shape) < 0.4, t * generator.choice([0.5, 1.0], shape), 0.0)
            t_max = np.where(generator.random(shape) < 0.4, t * generator.choice([1.0, 1.5], shape), np.inf)
            masks = generator.choice(RAY_MASKS, shape).astype(np.uint32)
            yield rays, {"t_min": t_min, "t_max": t_max, "mask": masks}

    is_hit, found = check(session, state, asked, tiles)
    assert is_hit.sum() > 500
    if not session.info.is_host:
        assert len(np.unique(found["leaf_count"])) > 1


@pytest.mark.on_both
def test_many_instances_are_listed_or_found_from_a_node_that_has_them(session, tiles):
    generator = np.random.default_rng(80)
    places = [(0, affine(random_linear(generator, 1.2), generator.uniform(-9, 9, 3))) for _ in range(600)]
    # A second cluster beside the first one, so that views of it begin below the root.
    places += [(0, row[1] + affine((0, 0, 0), (60, 0, 0)) - np.diag([0, 0, 0, 1])) for row in places]
    state = make_state([make_shape("icosphere", triangles=80)], *places)
    is_hit, found = check(session, state, lambda tracer: [(look((60, 2, -40), (60, 0, 0), 24.0), {})], tiles)
    assert is_hit.mean() > 0.5
    if session.info.is_host:
        return
    is_list = found["leaf_count"] > 1
    assert is_list.mean() > 0.05
    assert (found["top_node"][found["leaf_count"] == NO_LIST] != 0).mean() > 0.5
    for tile in found[is_list][:50]:
        count = tile["leaf_count"]
        assert len(set(tile["leaf"][:count])) == count
        assert (np.diff(tile["t_near"][:count]) >= 0).all()


@pytest.mark.on_both
def test_a_leaf_that_is_the_only_block(session, tiles):
    """The block 0 has the number that stands for no child."""
    mesh = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    for offset in (0, 5):
        state = make_state([mesh], (0, affine(turn(1, 0.5), (offset, 0, 0))), (0, affine(turn(1, 0.4), (-20, 0, 0))))
        rays = look((offset, 0.3, -4), (offset, 0.3, 0), 2.0)
        is_hit, _ = check(session, state, lambda tracer, rays=rays: [(rays, {})], tiles)
        assert is_hit.mean() > 0.05
