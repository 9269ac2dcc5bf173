"""Scenes with merged instances: every query answers as if nothing was merged."""

import itertools
from contextlib import contextmanager

import numpy as np
import pytest

import clbvh
from clbvh.trace.scene import merging

from ..scene_states import affine, random_linear

LAYOUTS = ("bvh2", "bvh4", "bvh8")
RAYS = 6000

# Rays that pass an edge more closely, in barycentric coordinates, may be decided either way.
CLEAR = 1e-3

# Distances from points are compared in float32, which has this error in the coordinates of the scene.
NEAR = 1e-5

# A box of numbers that float32 has, so that faces of boxes beside each other are equal.
BOX = clbvh.Mesh.from_arrays(
    np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, 8).T,
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]],
)  # fmt: skip


@contextmanager
def nothing_merged():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(merging, "find_groups", lambda *_: [])
        yield


@pytest.fixture(params=[0, 1], ids=lambda seed: f"seed{seed}")
def generator(request):
    return np.random.default_rng(request.param)


def place_randomly(generator, size=1.0):
    return affine(size * random_linear(generator, 1.5), generator.uniform(-4, 4, 3))


def make_scene(generator):
    """Twelve meshes that are placed once, half of them mirrored; between them a mesh placed thrice, and spheres."""
    scene = clbvh.Scene()
    knot = scene.add(clbvh.make_shape("knot", triangles=400))
    spheres = scene.add(clbvh.Spheres(generator.normal(size=(20, 3)), 0.2))
    for index in range(12):
        shape = clbvh.make_shape(("icosphere", "knot")[index % 2], triangles=200 + 100 * index)
        transform = place_randomly(generator)
        transform[:3, :3] *= np.sign(np.linalg.det(transform)) * (1 if index % 2 else -1)
        scene.place(scene.add(shape), transform, mask=1 if index % 6 == 0 else 3)
        if index % 4 == 0:
            scene.place(knot, place_randomly(generator, 0.5))
    scene.place(spheres, place_randomly(generator))
    return scene


@pytest.fixture
def tracers(generator, request):
    """Tracers of a scene: with merged instances, and with none."""
    scene = make_scene(generator)
    with clbvh.Tracer(scene, layout=request.param) as merged, nothing_merged():
        assert merged_ids(merged) == [2, 3, 4, 5, 7, 9, 10, 12, 13, 14]
        assert len(merged._caster.tree.merging.meshes) == 2
        with clbvh.Tracer(scene, layout=request.param) as apart:
            yield merged, apart


def merged_ids(tracer):
    return sorted(itertools.chain(*(found.merged_ids.tolist() for found in tracer._caster.tree.merging.meshes)))


def make_rays(generator):
    return generator.uniform(-7, 7, (RAYS, 3)), generator.normal(size=(RAYS, 3))


def is_clear(hits):
    return hits.is_hit & (np.minimum(np.minimum(hits.u, hits.v), 1 - hits.u - hits.v) > CLEAR)


def assert_same_hits(found, expected):
    """Where a hit is clear of edges, or a sphere's, all is the same."""
    clear = is_clear(found) | is_clear(expected)
    assert clear.mean() > 0.1
    for name in ("t", "u", "v", "prim_id", "instance_id", "geometry_id", "is_front", "locations"):
        np.testing.assert_array_equal(getattr(found, name)[clear], getattr(expected, name)[clear], name)
    np.testing.assert_array_equal(
        found.normals(smooth=True, facing=True)[clear], expected.normals(smooth=True, facing=True)[clear]
    )
    same = clear & (found.prim_id == expected.prim_id)
    # The corners are rounded in other coordinates.
    np.testing.assert_allclose(found.offset_origins()[same], expected.offset_origins()[same], rtol=0, atol=1e-4)


@pytest.mark.parametrize("tracers", LAYOUTS, indirect=True)
def test_rays_find_the_same(tracers, generator):
    merged, apart = tracers
    rays = make_rays(generator)
    expected = apart.closest_hit(*rays)
    assert_same_hits(merged.closest_hit(*rays), expected)
    assert len(np.unique(expected.instance_id)) > 10
    assert_same_hits(merged.closest_hit(*rays, mask=2), apart.closest_hit(*rays, mask=2))
    clear = is_clear(expected)
    np.testing.assert_array_equal(merged.any_hit(*rays)[clear], True)
    one, other = merged.all_hits(*rays), apart.all_hits(*rays)
    same = np.flatnonzero(merged.count_hits(*rays) == apart.count_hits(*rays))
    assert len(same) > 0.995 * RAYS
    for ray in same[:500]:
        mine, its = (slice(*found.offsets[ray : ray + 2]) for found in (one, other))
        np.testing.assert_array_equal(one.instance_id[mine], other.instance_id[its])
        np.testing.assert_array_equal(one.t[mine], other.t[its])
    first, few = merged.all_hits(*rays, max_hits=1), merged.closest_hit(*rays)
    np.testing.assert_array_equal(first.instance_id, few.instance_id[few.is_hit])
    np.testing.assert_array_equal(first.prim_id, few.prim_id[few.is_hit])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_rays_meet_the_same_side_of_flattened_meshes(layout, generator):
    """Balls that are nearly as flat as merged ones may be."""
    scene = clbvh.Scene()
    for _ in range(12):
        linear = np.linalg.qr(generator.normal(size=(3, 3)))[0] @ np.diag([1, 1, 3e-4])
        linear *= np.sign(np.linalg.det(linear))
        scene.place(
            scene.add(clbvh.make_shape("icosphere", triangles=320)), affine(linear, generator.uniform(-4, 4, 3))
        )
    origins, _ = make_rays(generator)
    centres = scene.snapshot().transforms[generator.integers(12, size=RAYS), :3, 3]
    rays = origins, centres + generator.normal(size=(RAYS, 3)) * 0.5 - origins
    with clbvh.Tracer(scene, layout=layout) as merged, nothing_merged(), clbvh.Tracer(scene, layout=layout) as apart:
        assert merged_ids(merged) == list(range(12))
        found, expected = merged.closest_hit(*rays), apart.closest_hit(*rays)
        assert_same_hits(found, expected)


@pytest.mark.parametrize("tracers", LAYOUTS, indirect=True)
def test_points_find_the_same(tracers, generator):
    merged, apart = tracers
    points = generator.uniform(-5, 5, (2000, 3))
    found, expected = merged.closest_point(points), apart.closest_point(points)
    np.testing.assert_allclose(found.distance, expected.distance, rtol=0, atol=NEAR)
    assert (found.instance_id == expected.instance_id).mean() > 0.999
    np.testing.assert_array_equal(merged.contains(points), apart.contains(points))
    assert 0.02 < merged.contains(points).mean() < 0.98
    np.testing.assert_array_equal(merged.signed_distance(points), apart.signed_distance(points))
    chosen = merged_ids(merged)[:2]
    for query in ("contains", "signed_distance"):
        ask = [getattr(tracer, query)(points, instance=chosen) for tracer in tracers]
        np.testing.assert_array_equal(*ask)
    ask = [tracer.closest_point(points, instance=chosen) for tracer in tracers]
    np.testing.assert_array_equal(ask[0].instance_id, ask[1].instance_id)
    assert set(ask[0].instance_id) == set(chosen)
    np.testing.assert_array_equal(*(tracer.closest_point(points, mask=2).instance_id != 0 for tracer in tracers))


@pytest.mark.parametrize("tracers", LAYOUTS, indirect=True)
def test_what_moves_leaves(tracers, generator):
    merged, apart = tracers
    rays, points = make_rays(generator), generator.uniform(-5, 5, (500, 3))
    before = merged_ids(merged)
    moves = [before[:1], before[:1], before[2:4], [0, 1], before]
    for left, ids in zip((before[1:], before[1:], [before[1], *before[4:]], None, []), moves, strict=True):
        matrices = [place_randomly(generator) for _ in ids]
        buffers = dict(merged._caster.tree.arguments)
        for tracer in tracers:
            tracer.set_transforms(ids, matrices)
        assert left is None or merged_ids(merged) == left
        if ids is moves[1]:
            assert merged._caster.tree.arguments["blocks"] is buffers["blocks"]
        assert_same_hits(merged.closest_hit(*rays), apart.closest_hit(*rays))
        np.testing.assert_array_equal(merged.contains(points), apart.contains(points))


def test_a_group_that_is_left_one_by_one_is_dissolved(generator):
    """Twelve boxes: after four calls the rest is still merged, and after the fifth nothing is."""
    scene = clbvh.Scene()
    for index in range(12):
        scene.place(scene.add(BOX), affine(offset=(3 * index, 0, 0)))
    origins = np.column_stack((generator.uniform(-1, 34, 500), generator.uniform(-9, 9, 500), np.full(500, 5.0)))
    with clbvh.Tracer(scene) as merged, nothing_merged(), clbvh.Tracer(scene) as apart:
        for call in range(6):
            for tracer in (merged, apart):
                tracer.set_transforms([call], [affine(offset=(3 * call, call, 0))])
            assert merged_ids(merged) == (list(range(call + 1, 12)) if call < 4 else [])
            found, expected = (tracer.closest_hit(origins, [0, 0, -1]) for tracer in (merged, apart))
            np.testing.assert_array_equal(found.instance_id, expected.instance_id)


@pytest.mark.parametrize("tracers", LAYOUTS, indirect=True)
def test_what_is_bent_leaves(tracers, generator):
    merged, apart = tracers
    rays = make_rays(generator)
    instance = merged_ids(merged)[1]
    geometry_id = int(merged._caster.tree.state.geometry_ids[instance])
    geometry = merged._scene._contents.geometries[geometry_id]
    before = merged_ids(merged)
    for stretch in (1.2, 1.4):
        for tracer in tracers:
            tracer.set_vertices(geometry, geometry.shape.vertices * [stretch, 1, 1])
        assert merged_ids(merged) == [other for other in before if other != instance]
        assert_same_hits(merged.closest_hit(*rays), apart.closest_hit(*rays))


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("apart_id", range(6))
def test_ties_go_to_the_smaller_instance(layout, apart_id):
    """Six boxes in one place, one of which is placed once more, and so not merged; one after the other leaves."""
    scene = clbvh.Scene()
    twice = scene.add(BOX)
    for index in range(6):
        scene.place(twice if index == apart_id else scene.add(BOX))
    scene.place(twice, affine(offset=(0, 0, 99)))
    origins = np.random.default_rng(0).uniform(-0.9, 0.9, (200, 3)) + np.array([0, 0, 4])
    with clbvh.Tracer(scene, layout=layout) as tracer:
        for least in range(6):
            left = [index for index in range(least, 6) if index != apart_id]
            assert merged_ids(tracer) == (left if len(left) > 1 else [])
            hits = tracer.closest_hit(origins, [0, 0, -1])
            assert set(hits.instance_id) == {least}
            assert set(tracer.closest_point(origins * [1, 1, -1]).instance_id) == {least}
            found = tracer.all_hits(origins[0], [0, 0, -1])
            assert found.instance_id.tolist() == [*range(least, 6), *range(least, 6)]
            first = tracer.all_hits(origins, [0, 0, -1], max_hits=1)
            np.testing.assert_array_equal(first.prim_id, hits.prim_id)
            tracer.set_transforms([least], [affine(offset=(100, 0, 0))])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_faces_that_touch_are_both_hit(layout):
    """Boxes in a row: at each face between two, rays along the row hit both, in the order of their t."""
    scene = clbvh.Scene()
    for index in range(8):
        scene.place(scene.add(BOX), affine(offset=(2 * (7 - index), 0, 0)))
    generator = np.random.default_rng(3)
    origins = np.column_stack((np.full(300, -3.0), generator.uniform(-0.9, 0.9, (300, 2))))
    with clbvh.Tracer(scene, layout=layout) as tracer:
        assert len(merged_ids(tracer)) == 8
        hits = tracer.all_hits(origins, [1, 0, 0])
        assert (np.diff(hits.offsets) == 16).all()
    with nothing_merged(), clbvh.Tracer(scene, layout=layout) as tracer:
        expected = tracer.all_hits(origins, [1, 0, 0])
        np.testing.assert_array_equal(hits.instance_id, expected.instance_id)
        np.testing.assert_array_equal(hits.prim_id, expected.prim_id)
        np.testing.assert_array_equal(hits.t, expected.t)


def test_a_mesh_far_away_is_as_exact():
    """Hits on meshes that are 10^7 units away, or a millionth as large, are those of a scene of theirs alone."""
    scene, alone = clbvh.Scene(), clbvh.Scene()
    ball = clbvh.make_shape("icosphere", triangles=1280)
    for index in range(6):
        scene.place(scene.add(ball), affine(offset=(3 * index, 0, 0)))
    for transform in (affine(offset=(1e7, 0, 0)), affine([1e-6] * 3, (0, 5, 0))):
        scene.place(scene.add(ball), transform)
        alone.place(alone.add(ball), transform)
    generator = np.random.default_rng(0)
    directions = generator.normal(size=(1000, 3))
    with clbvh.Tracer(scene) as tracer, clbvh.Tracer(alone) as few:
        for instance, (size, centre) in enumerate([(1.0, (1e7, 0, 0)), (1e-6, (0, 5, 0))]):
            origins = np.array(centre) - 3 * size * directions + generator.normal(size=(1000, 3)) * size * 0.3
            hits, expected = tracer.closest_hit(origins, directions), few.closest_hit(origins, directions)
            assert expected.is_hit.mean() > 0.5
            np.testing.assert_array_equal(hits.prim_id, expected.prim_id)
            np.testing.assert_array_equal(hits.instance_id, np.where(expected.is_hit, instance + 6, -1))
            np.testing.assert_array_equal(hits.t, expected.t)


@pytest.mark.parametrize("shading", ["lambert+shadow", "normal", "studio"])
@pytest.mark.parametrize("smooth", [0, 60])
def test_a_picture_is_the_same(shading, smooth):
    """Of meshes that are turned and stretched evenly, because those that are sheared are shaded by other normals."""
    scene = clbvh.Scene()
    generator = np.random.default_rng(5)
    for index in range(10):
        colour = None if index % 3 == 0 else tuple(generator.uniform(0, 1, 3))
        shape = clbvh.make_shape(("icosphere", "knot")[index % 2], triangles=300)
        turned = np.linalg.qr(generator.normal(size=(3, 3)))[0]
        turned *= np.sign(np.linalg.det(turned)) * (1 if index < 5 else -1)
        scene.place(scene.add(shape), affine(turned, generator.uniform(-2, 2, 3)), colour=colour)
    shown = scene.with_changes(width=96, height=64, shading=shading, smooth=smooth)
    options = clbvh.RenderOptions(validate=True)
    picture = clbvh.render(shown, options=options)
    with nothing_merged():
        expected = clbvh.render(shown, options=options)
    assert len(picture.objects.merging.meshes) == 2
    assert picture.objects.trees == (None,) * 10
    assert None not in expected.objects.trees
    differs = (np.abs(picture.rgb.astype(int) - expected.rgb) > 2).any(axis=-1)
    assert differs.mean() < 0.005
    assert (picture.hits.instance_id != expected.hits.instance_id).mean() < 0.002
    assert picture.report()["triangles"] == expected.report()["triangles"]
