"""The surface that was hit: a mesh, or the instances of a scene."""

import copy
import pickle

import numpy as np
import pytest

import clbvh
from clbvh.errors import ConfigError
from clbvh.trace.hits.hits import Hits
from clbvh.trace.hits.surface import Surface

KNOT = clbvh.make_shape("knot", triangles=2000)
BALLS = clbvh.Spheres(np.random.default_rng(7).normal(size=(40, 3)), np.linspace(0.01, 1, 40))


def place(shapes, geometry_id, transforms):
    names = [shape.name for shape in shapes]
    return Surface.from_shapes(shapes, names, np.asarray(geometry_id), np.asarray(transforms))


def random_transforms(count, generator):
    transforms = np.tile(np.eye(4), (count, 1, 1))
    transforms[:, :3] = generator.normal(size=(count, 3, 4))
    return transforms


def random_hits(surface, count, generator):
    """Hits on random primitives of random instances; some are misses."""
    geometry_id = surface.arrays.geometry_id
    instance_id = generator.integers(0, len(geometry_id), count).astype(np.int32)
    prim_counts = np.array([shape.prim_count for shape in surface.shapes])[geometry_id[instance_id]]
    prim_id = (generator.random(count) * prim_counts).astype(np.int32)
    is_hit = generator.random(count) < 0.9
    u, v = generator.uniform(0, 0.5, (2, count)) * is_hit
    return Hits(
        np.where(is_hit, 1.0, np.inf), u, v, np.where(is_hit, prim_id, -1).astype(np.int32),
        is_front=is_hit & (generator.random(count) < 0.5),
        surface=surface, known_instance_id=np.where(is_hit, instance_id, -1).astype(np.int32),
    )  # fmt: skip


def corners_of(hits, hit):
    """(3, 3) float64: the corners of a triangle that was hit, in its object's coordinates."""
    mesh = hits.surface.shapes[hits.geometry_id[hit]]
    return mesh.vertices[mesh.faces[hits.prim_id[hit]]]


def ball_normal(hits, hit):
    azimuth, polar = 2 * np.pi * hits.u[hit], np.pi * hits.v[hit]
    return np.array([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)])


def expected_point(hits, hit):
    transform = hits.surface.arrays.linear[hits.instance_id[hit]], hits.surface.arrays.offset
    shape = hits.surface.shapes[hits.geometry_id[hit]]
    if isinstance(shape, clbvh.Spheres):
        prim = hits.prim_id[hit]
        point = shape.centres[prim] + shape.radii[prim] * ball_normal(hits, hit)
        normal = ball_normal(hits, hit)
    else:
        a, b, c = corners_of(hits, hit)
        point = (1 - hits.u[hit] - hits.v[hit]) * a + hits.u[hit] * b + hits.v[hit] * c
        normal = np.cross(b - a, c - a)
    normal = np.linalg.inv(transform[0]).T @ normal
    return transform[0] @ point + transform[1][hits.instance_id[hit]], normal / np.linalg.norm(normal)


@pytest.mark.parametrize("seed", [0, 1])
def test_locations_and_normals_are_those_of_the_formulas(seed):
    generator = np.random.default_rng(seed)
    surface = place([KNOT, BALLS, KNOT], [2, 1, 0, 1], random_transforms(4, generator))
    hits = random_hits(surface, 300, generator)
    locations, normals = hits.locations, hits.normals
    assert np.isnan(locations[~hits.is_hit]).all()
    assert np.isnan(normals[~hits.is_hit]).all()
    for hit in np.flatnonzero(hits.is_hit):
        location, normal = expected_point(hits, hit)
        np.testing.assert_allclose(locations[hit], location, atol=1e-13)
        np.testing.assert_allclose(normals[hit], normal, atol=1e-11)


def test_ids_of_hits_in_a_scene():
    surface = place([KNOT, BALLS], [1, 0, 1], random_transforms(3, np.random.default_rng(0)))
    nothing = np.zeros(4)
    hits = Hits(
        nothing, nothing, nothing, np.array([5, 6, -1, 7], np.int32),
        surface=surface, known_instance_id=np.array([0, 1, -1, 2], np.int32),
    )  # fmt: skip
    assert hits.mesh is None
    assert hits.geometry_id.tolist() == [1, 0, -1, 1]
    assert hits.instance_id.tolist() == [0, 1, -1, 2]
    assert hits.geometry_id.dtype == hits.instance_id.dtype == np.int32
    assert hits[1:].instance_id.tolist() == [1, -1, 2]
    assert hits.take(np.array([3, 1])).geometry_id.tolist() == [1, 0]
    assert [int(hit.geometry_id) for hit in hits] == [1, 0, -1, 1]
    assert hits[3].geometry_id.shape == ()


def test_ids_of_hits_of_a_mesh_are_zero_for_hits():
    prim_id = np.array([[5, -1], [0, 1999]], np.int32)
    hits = Hits(*np.zeros((3, 2, 2)), prim_id, KNOT)
    for ids in (hits.geometry_id, hits.instance_id):
        assert ids.tolist() == [[0, -1], [0, 0]]
        assert ids.dtype == np.int32
    assert hits[0, 1].instance_id.shape == ()
    assert int(hits[0, 1].instance_id) == -1


def test_an_empty_scene_has_misses_only():
    surface = place([], np.empty(0, int), np.empty((0, 4, 4)))
    misses = np.full(2, -1, np.int32)
    hits = Hits(np.full(2, np.inf), *np.zeros((2, 2)), misses, surface=surface, known_instance_id=misses)
    assert hits.geometry_id.tolist() == [-1, -1]
    assert np.isnan(hits.locations).all()
    assert np.isnan(hits.normals).all()
    assert surface.reach == 0


def test_the_identity_gives_the_bytes_of_the_mesh():
    surface = place([BALLS, KNOT], [1], [np.eye(4)])
    placed = random_hits(surface, 500, np.random.default_rng(3))
    plain = Hits(placed.t, placed.u, placed.v, placed.prim_id, KNOT, is_front=placed.is_front)
    assert placed.locations.tobytes() == plain.locations.tobytes()
    np.testing.assert_allclose(placed.normals, plain.normals, rtol=0, atol=3e-16)


@pytest.mark.parametrize("unit", [1e-30, 1e30])
@pytest.mark.parametrize("stretch", [1e-30, 1e-6, 1.0, 1e30])
def test_normals_of_extreme_scales_are_perpendicular_and_of_length_one(unit, stretch):
    generator = np.random.default_rng(5)
    transforms = random_transforms(1, generator)
    transforms[0, :3, :3] = np.linalg.qr(transforms[0, :3, :3])[0] * np.array([1, stretch, 1]) * unit
    surface = place([KNOT, BALLS], [0], transforms)
    hits = random_hits(surface, 200, generator)
    normals = hits.normals[hits.is_hit]
    np.testing.assert_allclose((normals**2).sum(axis=1), 1, atol=1e-14)
    for hit, normal in zip(np.flatnonzero(hits.is_hit), normals, strict=True):
        a, b, c = corners_of(hits, hit)
        edges = np.stack((b - a, c - a)) @ surface.arrays.linear[0].T
        heights = np.abs(edges @ normal) / np.abs(edges).max(axis=1)
        assert heights.max() < 1e-10


def test_normals_of_a_mirrored_object_stay_on_its_outer_side():
    sphere = clbvh.make_shape("icosphere", triangles=320)
    surface = place([sphere, BALLS], [0, 1], [np.diag([-1, 1, 1, 1])] * 2)
    assert surface.arrays.is_mirrored.all()
    faces = np.arange(sphere.face_count, dtype=np.int32)
    third = np.full(len(faces), 1 / 3)
    hits = Hits(third, third, third, faces, surface=surface, known_instance_id=0 * faces)
    assert ((hits.normals * hits.locations).sum(axis=1) > 0.9).all()
    balls = Hits(
        *np.full((3, 40), 0.125), np.arange(40, dtype=np.int32),
        surface=surface, known_instance_id=np.ones(40, np.int32),
    )  # fmt: skip
    outwards = (balls.locations - BALLS.centres * [-1, 1, 1]) / BALLS.radii[:, None]
    np.testing.assert_allclose(balls.normals, outwards, atol=1e-13)


def test_a_far_instance_has_full_float64_locations():
    transform = np.eye(4)
    transform[:3, 3] = [1e7, -1e7, 1e7]
    surface = place([KNOT], [0], [transform])
    hits = random_hits(surface, 200, np.random.default_rng(2))
    plain = Hits(hits.t, hits.u, hits.v, hits.prim_id, KNOT)
    np.testing.assert_array_equal(hits.locations, plain.locations + transform[:3, 3])


@pytest.mark.parametrize("kind", ["knot", "balls"])
def test_start_points_are_just_above_the_surface_on_the_side_of_the_ray(kind):
    generator = np.random.default_rng(4)
    shape = KNOT if kind == "knot" else BALLS
    surface = place([shape], [0, 0], random_transforms(2, generator))
    hits = random_hits(surface, 300, generator)
    heights = ((hits.offset_origins() - hits.locations) * hits.normals).sum(axis=1)
    assert np.isnan(heights[~hits.is_hit]).all()
    heights = heights[hits.is_hit]
    np.testing.assert_array_equal(heights > 0, hits.is_front[hits.is_hit])
    assert (np.abs(heights) > 0).all()
    assert np.abs(heights).max() < 1e-3
    towards = hits.normals * generator.choice([-1, 1], len(hits.t))[:, None]
    leaving = hits.offset_origins(towards=np.nan_to_num(towards)) - hits.locations
    assert ((leaving * towards).sum(axis=1)[hits.is_hit] > 0).all()


def test_hits_that_know_neither_mesh_nor_scene_say_so():
    hits = Hits(*np.zeros((3, 1)), np.zeros(1, np.int32))
    assert hits.instance_id.tolist() == [0]
    with pytest.raises(ConfigError, match="do not know their mesh"):
        _ = hits.normals


def test_a_copy_or_a_pickle_of_hits_knows_what_they_know():
    generator = np.random.default_rng(1)
    hits = Hits(*np.full((3, 4), 0.25), np.array([5, -1, 0, 7], np.int32), KNOT, is_front=np.ones(4, np.bool_))
    placed = random_hits(place([KNOT, BALLS], [1, 0], random_transforms(2, generator)), 30, generator)
    for given in (hits, placed):
        for other in (copy.copy(given), copy.deepcopy(given), pickle.loads(pickle.dumps(given))):
            assert (other.mesh is None) == (given.mesh is None)
            assert other.geometry_id.tobytes() == given.geometry_id.tobytes()
            assert other.offset_origins().tobytes() == given.offset_origins().tobytes()


@pytest.mark.parametrize("shape", [KNOT, BALLS], ids=["mesh", "spheres"])
def test_a_lone_shape_has_the_surface_of_its_instance_in_the_same_place(shape):
    lone, placed = (Surface.from_shapes([shape], ["shape"], np.zeros(1, np.int32), t) for t in (None, np.eye(4)[None]))
    assert lone.lone_mesh is (shape if isinstance(shape, clbvh.Mesh) else None)
    assert placed.lone_mesh is None
    hits = random_hits(placed, 300, np.random.default_rng(6))
    alone = Hits(hits.t, hits.u, hits.v, hits.prim_id, is_front=hits.is_front, surface=lone)
    assert alone.locations.tobytes() == hits.locations.tobytes()
    np.testing.assert_allclose(alone.normals, hits.normals, rtol=0, atol=1e-15)
    leaps = [np.linalg.norm(each.offset_origins() - each.locations, axis=1)[hits.is_hit] for each in (alone, hits)]
    # No map between the ray and the shape rounds anything.
    assert (leaps[0] < leaps[1] * (1 + 1e-9)).all()
    assert (leaps[0] > leaps[1] / 4).all()
