"""Rays of a scene that begin where their tile's beam leads them hit what they hit from the root, byte for byte."""

from unittest.mock import patch

import numpy as np
import pytest

import clbvh
from clbvh import Tracer
from clbvh.rendering.cameras.framing import frame_mesh
from clbvh.structs import ENTRY_POINT_LAYOUTS, TILE
from clbvh.trace import put_rays
from clbvh.trace.rays import pieces
from clbvh.trace.world.world import World

from ...profiles import seeds
from ...property.random_scenes import KINDS, LINEAR, RAY_MASKS, make_scene, scale_scene
from .scene_states import ALL, affine, make_state, random_linear, turn

WIDTH, HEIGHT = 75, 44  # no multiples of a tile's

NO_LIST, NO_INSTANCE = -1, -1


@pytest.fixture(scope="module")
def device(_opened_device):
    return _opened_device


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    """Take the few rays of these tests for those of a picture."""
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    monkeypatch.setattr(pieces, "is_scattered", lambda *arguments: False)


@pytest.fixture
def tiles(monkeypatch):
    """The tiles that are found from now on, launch by launch."""
    found, find = [], put_rays.find_entry_points

    def record(session, world, kernel, take, work_size, tile, **arguments):
        starts = find(session, world, kernel, take, work_size, tile, **arguments)
        columns, rows = (-(-length // edge) for length, edge in zip(work_size, tile, strict=True))
        with session.mapped(starts["tiles"], columns * rows, TILE, write=False) as items:
            found.append(items.copy())
        return starts

    monkeypatch.setattr(put_rays, "find_entry_points", record)
    return found


def look(eye, towards, width, *, is_parallel=False):
    """Rays of a square picture of this width at the distance of `towards`: (HEIGHT, WIDTH, 3) each."""
    way = np.asarray(towards, np.float64) - eye
    distance = np.linalg.norm(way)
    axes = np.linalg.svd(way[None] / distance)[2]
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


def contents(state):
    scene = clbvh.Scene()
    geometries = [scene.add(shape) for shape in state.shapes]
    for geometry, transform, mask in zip(state.geometry_ids, state.transforms, state.masks, strict=True):
        scene.place(geometries[geometry], transform, mask=int(mask))
    return scene


def check_all(device, scene, asked, tiles):
    """Ask with and without entry points, in all layouts that have them; return the closest hits of each of `asked`.

    `asked` yields rays and limits, given the tracer.
    """
    answers = []
    for layout in ENTRY_POINT_LAYOUTS:
        with Tracer(scene, device=device.info, layout=layout) as tracer:
            for has_entry_points in (True, False):
                before = len(tiles)
                with patch.object(World, "has_entry_points", has_entry_points):
                    answers.append([ask(tracer, *rays, **limits) for rays, limits in asked(tracer)])
                assert (len(tiles) > before) == has_entry_points
    for others in answers[1:]:
        for (bits, _), (other, _) in zip(answers[0], others, strict=True):
            assert bits == other
    return [closest for _, closest in answers[0]]


def check(device, scene, rays, tiles, **limits):
    """The closest hits, which entry points do not change, and all tiles."""
    (closest,) = check_all(device, scene, lambda tracer: [(rays, limits)], tiles)
    return closest, np.concatenate(tiles)


def random_views(scene, generator):
    """Pictures of a random scene: of all of it, of an instance, along an axis, from within."""
    state = scene.state
    chosen = generator.integers(0, len(state.transforms))
    linear, target = state.transforms[chosen, :3, :3], state.transforms[chosen, :3, 3]
    size = 8 * np.linalg.norm(linear, 2)
    way = generator.normal(size=3)
    way *= size / np.linalg.norm(way)
    yield look(target - 2 * way, target, 2 * size)
    yield look(target - 50 * way, target, size)
    yield look(target - 2e4 * way, target, size)
    yield look(target, target + way, 3 * size)
    axis = size * np.eye(3)[generator.integers(0, 3)]
    yield look(target - 3 * axis, target, size, is_parallel=True)


@pytest.mark.parametrize("scale", [1.0, 1e-30, 1e30])
@pytest.mark.parametrize("is_far", [False, True], ids=["near", "far"])
@pytest.mark.parametrize("seed", seeds(2))
def test_random_scenes(device, tiles, seed, is_far, scale):
    scene = scale_scene(make_scene(seed, tuple(KINDS), tuple(LINEAR), is_far=is_far), scale)

    def asked(tracer):
        generator = np.random.default_rng([seed, 77])
        for rays in random_views(scene, generator):
            yield rays, {}
            first = tracer.closest_hit(*rays)
            t, shape = np.where(first.is_hit, first.t, 1.0), first.t.shape
            yield (
                rays,
                {
                    "t_min": np.where(generator.random(shape) < 0.4, t * generator.choice([0.5, 1.0], shape), 0.0),
                    "t_max": np.where(generator.random(shape) < 0.4, t * generator.choice([1.0, 1.5], shape), np.inf),
                    "mask": generator.choice(RAY_MASKS, shape).astype(np.uint32),
                },
            )

    hits = check_all(device, contents(scene.state), asked, tiles)
    assert sum(each.count for each in hits) > 500
    kinds = np.concatenate(tiles)["leaf_count"]
    assert len(np.unique(kinds)) > 1


@pytest.mark.parametrize("seed", seeds(4))
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_mesh_under_any_map_is_entered_at_once(device, tiles, seed, dtype):
    generator = np.random.default_rng([seed, 78])
    mesh = clbvh.make_shape("knot", triangles=3000)
    state = make_state([mesh], (0, affine(random_linear(generator), generator.uniform(-1e3, 1e3, 3))))
    vertices = mesh.vertices @ state.transforms[0, :3, :3].T + state.transforms[0, :3, 3]
    camera = frame_mesh(clbvh.Mesh.from_arrays(vertices, mesh.faces), aspect=WIDTH / HEIGHT)
    rays = tuple(part.astype(dtype) for part in camera.rays(WIDTH, HEIGHT))
    hits, found = check(device, contents(state), rays, tiles)
    assert 0.02 < hits.is_hit.mean() < 0.98
    assert (found["leaf_count"] == 0).mean() > 0.02
    assert (found["instance_index"] != NO_INSTANCE).mean() > 0.1


def test_spheres_are_entered_at_once(device, tiles):
    generator = np.random.default_rng(79)
    spheres = clbvh.Spheres(generator.normal(size=(500, 3)), generator.uniform(0.01, 0.2, 500))
    state = make_state([spheres], (0, affine(turn(2, 0.3) @ np.diag([1, 0.5, 2]), (3, 4, 5))))
    hits, found = check(device, contents(state), look((3, 4, -9), (3, 4, 5), 9.0), tiles)
    assert 0.05 < hits.is_hit.mean() < 0.95
    assert (found["instance_index"] != NO_INSTANCE).mean() > 0.2


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_many_instances_are_listed_or_found_from_a_node_that_has_them(device, tiles, dtype):
    generator = np.random.default_rng(80)
    places = [(0, affine(random_linear(generator, 1.2), generator.uniform(-9, 9, 3))) for _ in range(600)]
    # A second cluster beside the first one, so that views of it begin below the root.
    places += [(0, row[1] + affine((0, 0, 0), (60, 0, 0)) - np.diag([0, 0, 0, 1])) for row in places]
    state = make_state([clbvh.make_shape("icosphere", triangles=80)], *places)
    rays = tuple(part.astype(dtype) for part in look((60, 2, -40), (60, 0, 0), 24.0))
    hits, found = check(device, contents(state), rays, tiles)
    assert hits.is_hit.mean() > 0.5
    is_list = found["leaf_count"] > 1
    assert is_list.mean() > 0.05
    assert (found["top_node"][found["leaf_count"] == NO_LIST] != 0).mean() > 0.5
    for tile in found[is_list][:50]:
        count = tile["leaf_count"]
        assert len(set(tile["leaf"][:count])) == count
        assert (np.diff(tile["t_near"][:count]) >= 0).all()


def test_instances_that_no_ray_of_a_tile_sees_are_left_out(device, tiles):
    state = make_state([clbvh.make_shape("icosphere", triangles=80)], (0, affine(turn(0, 1.0)), 2))
    rays = look((0, 0, -6), (0, 0, 0), 1.0)
    hits, found = check(device, contents(state), rays, tiles, mask=1)
    assert hits.count == 0
    assert (found["leaf_count"] == 0).all()
    tiles.clear()
    hits, found = check(device, contents(state), rays, tiles, mask=2)
    assert hits.is_hit.all()
    assert (found["leaf_count"] == 1).all()


def test_a_leaf_that_is_the_only_block(device, tiles):
    """The block 0 has the number that stands for no child."""
    mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    for offset in (0, 5):
        state = make_state([mesh], (0, affine(turn(1, 0.5), (offset, 0, 0))), (0, affine(turn(1, 0.4), (-20, 0, 0))))
        hits, _ = check(device, contents(state), look((offset, 0.3, -4), (offset, 0.3, 0), 2.0), tiles)
        assert hits.is_hit.mean() > 0.05


@pytest.mark.parametrize("changed", [None, 7, -2])
def test_rays_that_share_an_eye_are_those_that_do_not(device, changed):
    """One low part for all rays gives what one for each gives; also where a single ray has another origin."""
    state = make_scene(3, tuple(KINDS), tuple(LINEAR)).state
    origins, directions = (part.reshape(-1, 3).astype(np.float32) for part in look((0.1, 0.2, -40), (0, 0, 0), 30))
    origins = origins.copy()
    if changed is not None:
        origins[changed] += 1e-3
    masks = np.full(len(origins), ALL, np.uint32)
    with Tracer(contents(state), device=device.info) as tracer:
        (shared, _), (single, _) = (ask(tracer, origins, directions, mask=mask) for mask in (ALL, masks))
    assert shared == single
