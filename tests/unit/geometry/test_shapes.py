"""The procedural meshes and spheres: size, form, closedness, repeatability, and what is refused."""

import numpy as np
import pytest
import trimesh

from clbvh import ConfigError, make_shape
from clbvh.geometry.shapes.make_shape import SHAPES
from clbvh.geometry.shapes.make_spheres import SPHERE_SETS, make_spheres
from clbvh.geometry.shapes.palace import HALL_TRIANGLES

CLOSED = ("knot", "blobs", "boxes", "icosphere", "cube")
# Of one size, whatever number of triangles is wanted.
FIXED = {"square": 2, "cube": 12}


def solid(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_sound_and_repeatable(name):
    for triangles, seed in ((162, 0), (1000, 5), (20_011, 0)):
        mesh = make_shape(name, triangles=triangles, seed=seed)
        assert FIXED.get(name, triangles // 4 + 1) <= mesh.face_count <= FIXED.get(name, triangles)
        assert mesh.degenerate_count == 0
        assert len(np.unique(mesh.faces)) == len(mesh.vertices)
        assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
        assert solid(mesh).is_volume == (name in CLOSED)  # closed, wound alike, and not inside out
    again, other = (make_shape(name, triangles=triangles, seed=number) for number in (seed, seed + 1))
    assert again.fingerprint == mesh.fingerprint
    assert (other.fingerprint == mesh.fingerprint) == (name == "icosphere" or name in FIXED)


def test_how_many_triangles_are_delivered():
    for name, triangles, delivered in (
        ("knot", 871_200, 871_200),  # 2 x 1980 x 220
        ("blobs", 24_000, 24_000),  # 300 balls of 80
        ("palace", 3 * HALL_TRIANGLES, 3 * HALL_TRIANGLES),
    ):
        assert make_shape(name, triangles=triangles).face_count == delivered, name


def test_squares_cubes_spheres_and_terrain_have_their_forms():
    square, cube = make_shape("square", triangles=2), make_shape("cube", triangles=12)
    assert np.ptp(square.vertices, axis=0).tolist() == [1, 0, 1]
    assert solid(cube).volume == pytest.approx(1)
    ball = make_shape("icosphere", triangles=20 * 30**2)
    assert np.linalg.norm(ball.vertices, axis=1) == pytest.approx(1, abs=1e-6)
    assert solid(ball).volume == pytest.approx(4 / 3 * np.pi, rel=5e-3)
    coarse, fine = (make_shape("terrain", triangles=2 * n * n, seed=4) for n in (64, 128))
    for mesh in (square, coarse):
        assert (solid(mesh).face_normals[:, 1] > 0).all()
    assert np.ptp(coarse.vertices, axis=0)[[0, 2]] == pytest.approx(10)
    # A finer terrain is the same landscape.
    heights = [mesh.vertices[:, 1].reshape(n + 1, n + 1) for mesh, n in ((coarse, 64), (fine, 128))]
    assert np.abs(heights[0] - heights[1][::2, ::2]).mean() < 0.03 * np.ptp(heights[1])


def test_options_change_the_shape():
    assert np.ptp(make_shape("terrain", triangles=5000, height=0).vertices[:, 1]) == 0
    knot = make_shape("knot", triangles=8000, turns=3, loops=7, strands=2, crossings=60, thickness=0.2)
    assert solid(knot).is_volume
    small, large = (make_shape("boxes", triangles=1200, size=size) for size in (0.5, 2))
    assert solid(large).volume == pytest.approx(64 * solid(small).volume, rel=1e-5)
    wide, plain = (np.ptp(make_shape("blobs", triangles=8000, **options).vertices) for options in ({"spread": 3}, {}))
    assert wide > 2 * plain
    tight, loose = (np.ptp(make_shape("palace", triangles=n * HALL_TRIANGLES).vertices, axis=0) for n in (6, 24))
    assert loose[0] * loose[2] > 2 * tight[0] * tight[2]
    assert loose[1] == pytest.approx(tight[1])


def test_shapes_that_cannot_be_made_are_refused():
    for name, options, message in (
        ("teapot", {}, "no shape 'teapot': take one of knot, terrain"),
        ("knot", {"triangles": 161}, "'knot' needs at least 162 triangles, not 161"),
        ("knot", {"triangles": -5}, "triangles must be a whole number"),
        ("knot", {"height": 1}, "'knot' has no option 'height': it has turns, loops"),
        ("terrain", {"height": "tall"}, "'height' .* must be a number from 0, not 'tall'"),
        ("knot", {"turns": 2, "loops": 4}, "no common divisor, but 2 and 4 do"),
    ):
        with pytest.raises(ConfigError, match=message):
            make_shape(name, **({"triangles": 1000} | options))


@pytest.mark.parametrize("name", SPHERE_SETS)
def test_sets_of_spheres_are_sound_and_repeatable(name):
    for count in (1, 2, 5000):
        first, second, other = (make_spheres(name, count=count, seed=seed) for seed in (1, 1, 2))
        assert (first.centres.shape, first.radii.shape) == ((count, 3), (count,))
        assert first.fingerprint == second.fingerprint
    assert first.fingerprint != other.fingerprint


@pytest.mark.parametrize("count", [4, 5, 40, 480, 2500])
def test_spheres_of_the_weekend_touch_nothing_but_the_ground_and_have_materials(count):
    made = make_spheres("weekend", count=count, seed=1)
    centres, radii, looks = made.centres, made.radii, made.appearance
    assert radii.tolist() == [radii[0], 1, 1, 1, *[0.2] * (count - 4)]
    others = centres[1:]
    gaps = np.linalg.norm(others[:, None] - others[None], axis=2) - radii[1:, None] - radii[None, 1:]
    assert gaps[~np.eye(count - 1, dtype=bool)].min() > 1e-3
    assert np.abs(np.linalg.norm(others - centres[0], axis=1) - radii[0] - radii[1:]).max() < 1e-9 * radii[0]
    # The large ones keep their materials, and the small ones begin with the first of their own.
    assert looks.material_ids[:1004].tolist() == list(range(min(count, 1004)))
    assert looks.material_ids.max() < len(looks.materials) <= 1004


def test_spheres_that_cannot_be_made_are_refused():
    for arguments, message in (
        ({"name": "nebula"}, "no spheres 'nebula': take one of galaxy, weekend"),
        ({"loops": 3}, "no option 'loops': it has arms, winding"),
        ({"radius": -1}, "'radius' .* must be a number from 0, not -1"),
        ({"count": 2**31}, "2,147,483,648 spheres are too many"),
    ):
        with pytest.raises(ConfigError, match=message):
            make_spheres(**{"name": "galaxy", "count": 10, **arguments})
