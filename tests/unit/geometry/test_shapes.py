"""The procedural meshes and spheres: size, form, closedness, repeatability, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import ConfigError, make_shape
from clbvh.geometry.shapes import make_spheres as module
from clbvh.geometry.shapes.make_shape import SHAPES
from clbvh.geometry.shapes.make_spheres import SPHERE_SETS, make_spheres
from clbvh.geometry.shapes.palace import HALL_TRIANGLES

CLOSED = ("knot", "blobs", "boxes", "icosphere", "cube")
# Of one size, whatever number of triangles is wanted.
FIXED = {"square": 2, "cube": 12}


def is_closed(mesh):
    """Return whether each edge has exactly one triangle on either side, wound alike."""
    begin, end = (np.roll(mesh.faces, -step, axis=1).ravel().astype(np.int64) for step in range(2))
    forth = np.sort(begin * len(mesh.vertices) + end)
    back = np.sort(end * len(mesh.vertices) + begin)
    return bool((np.diff(forth) > 0).all() and (forth == back).all())


def volume_of(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->", np.cross(a, b), c) / 6)


def normals_of(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_sound_and_repeatable(name):
    for triangles, seed in ((162, 0), (1000, 5), (20_011, 0)):
        mesh = make_shape(name, triangles=triangles, seed=seed)
        assert FIXED.get(name, triangles // 4 + 1) <= mesh.face_count <= FIXED.get(name, triangles)
        assert mesh.degenerate_count == 0
        assert len(np.unique(mesh.faces)) == len(mesh.vertices)
        assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
        assert is_closed(mesh) == (name in CLOSED)
        assert name not in CLOSED or volume_of(mesh) > 0
    again, other = (make_shape(name, triangles=triangles, seed=number) for number in (seed, seed + 1))
    assert again.fingerprint == mesh.fingerprint
    assert (other.fingerprint == mesh.fingerprint) == (name == "icosphere" or name in FIXED)


def test_how_many_triangles_are_delivered():
    for name, triangles, delivered in (
        ("knot", 871_200, 871_200),  # 2 x 1980 x 220
        ("knot", 1001, 994),
        ("terrain", 2, 2),
        ("terrain", 1000, 968),
        ("blobs", 24_000, 24_000),  # 300 balls of 80
        ("boxes", 35, 24),
        ("icosphere", 20, 20),
        ("icosphere", 499, 320),
        ("palace", 3 * HALL_TRIANGLES, 3 * HALL_TRIANGLES),
    ):
        assert make_shape(name, triangles=triangles).face_count == delivered, name


def test_squares_cubes_spheres_and_terrain_have_their_forms():
    square, cube = make_shape("square", triangles=2), make_shape("cube", triangles=12)
    assert (square.vertices.min(axis=0).tolist(), square.vertices.max(axis=0).tolist()) == (
        [-0.5, 0, -0.5],
        [0.5, 0, 0.5],
    )
    assert volume_of(cube) == pytest.approx(1)
    ball = make_shape("icosphere", triangles=20 * 30**2)
    assert np.linalg.norm(ball.vertices, axis=1) == pytest.approx(1, abs=1e-6)
    assert volume_of(ball) == pytest.approx(4 / 3 * np.pi, rel=5e-3)
    coarse, fine = (make_shape("terrain", triangles=2 * n * n, seed=4) for n in (64, 128))
    for mesh in (square, coarse):
        assert (normals_of(mesh)[:, 1] > 0).all()
    assert np.ptp(coarse.vertices, axis=0)[[0, 2]] == pytest.approx(10)
    # A finer terrain is the same landscape.
    heights = [mesh.vertices[:, 1].reshape(n + 1, n + 1) for mesh, n in ((coarse, 64), (fine, 128))]
    assert np.abs(heights[0] - heights[1][::2, ::2]).mean() < 0.03 * np.ptp(heights[1])


def test_a_palace_mixes_huge_thin_and_tiny_triangles_and_grows_sideways():
    mesh = make_shape("palace", triangles=100_000, seed=1)
    areas, corners = np.linalg.norm(normals_of(mesh), axis=1) / 2, mesh.vertices[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    slenderness = longest**2 / (2 * areas)
    assert areas.max() > max(1e4 * np.median(areas), 1e5 * areas.min())
    assert np.quantile(slenderness, 0.9) > 10
    assert np.median(slenderness) < 4
    small, large = (
        np.ptp(make_shape("palace", triangles=halls * HALL_TRIANGLES, seed=1).vertices, axis=0) for halls in (6, 24)
    )
    assert large[0] * large[2] > 2 * small[0] * small[2]
    assert large[1] == pytest.approx(small[1])


def test_options_change_the_shape():
    assert np.ptp(make_shape("terrain", triangles=5000, height=0).vertices[:, 1]) == 0
    plain = make_shape("knot", triangles=8000, relief=0, roughness=0, thickness=0.3)
    # A plain tube: volume is its length times the area of its section (Pappus).
    t = np.linspace(0, 2 * np.pi, 20_001)
    reach = 2 + 0.9 * np.cos(3 * t)
    curve = np.column_stack((reach * np.cos(2 * t), reach * np.sin(2 * t), 0.9 * np.sin(3 * t)))
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    assert volume_of(plain) == pytest.approx(length * np.pi * 0.3**2, rel=0.02)
    assert is_closed(make_shape("knot", triangles=8000, turns=3, loops=7, strands=2, crossings=60, thickness=0.2))
    small, large = (make_shape("boxes", triangles=1200, size=size) for size in (0.5, 2))
    assert volume_of(large) == pytest.approx(64 * volume_of(small), rel=1e-5)
    wide, plain = (np.ptp(make_shape("blobs", triangles=8000, **options).vertices) for options in ({"spread": 3}, {}))
    assert wide > 2 * plain


def test_shapes_that_cannot_be_made_are_refused():
    for name, options, message in (
        ("teapot", {}, "no shape 'teapot': take one of knot, terrain"),
        ("knot", {"triangles": 161}, "'knot' needs at least 162 triangles, not 161"),
        ("cube", {"triangles": 11}, "needs at least 12 triangles, not 11"),
        ("knot", {"triangles": -5}, "triangles must be a whole number"),
        ("knot", {"triangles": True}, "triangles must be a whole number"),
        ("knot", {"seed": -1}, "seed must be a whole number"),
        ("knot", {"height": 1}, "'knot' has no option 'height': it has turns, loops"),
        ("terrain", {"height": "tall"}, "'height' .* must be a number from 0, not 'tall'"),
        ("terrain", {"height": float("nan")}, "must be a number from 0"),
        ("knot", {"turns": 1.5}, "'turns' .* must be a whole number from 1"),
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


def test_a_galaxy_is_flat_dense_in_the_middle_and_has_arms():
    for arms in (2, 3):
        centres = make_spheres("galaxy", count=50_000, seed=1, arms=arms).centres
        assert np.median(np.abs(centres[:, 1])) < 0.15 * np.median(np.abs(centres[:, 0]))
        distance = np.hypot(centres[:, 0], centres[:, 2])
        assert 0.15 < (distance < 1.5).mean() < 0.5
        assert (distance < 15).all()
        # A ring of the disk, cut into sectors: an angular wave with one crest per arm stands out.
        angles = np.arctan2(centres[:, 2], centres[:, 0])[(distance > 5.8) & (distance < 6.2)]
        waves = [abs(np.exp(1j * number * angles).mean()) for number in range(1, 6)]
        assert int(np.argmax(waves)) + 1 == arms
    wide, narrow = (make_spheres("galaxy", count=500, radius=radius).centres for radius in (100, 10))
    assert np.allclose(wide, 10 * narrow)


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
    if count == 480:
        assert np.abs(centres[4:, [0, 2]]).max() < 13
        assert (centres[4:, [0, 2]] > 0).mean(axis=0) == pytest.approx(0.5, abs=0.05)


def test_spheres_that_cannot_be_made_are_refused(monkeypatch):
    for arguments, message in (
        ({"name": "nebula"}, "no spheres 'nebula': take one of galaxy, weekend"),
        ({"loops": 3}, "no option 'loops': it has arms, winding"),
        ({"arms": 2.5}, "'arms' .* must be 1 to 100, not 2.5"),
        ({"bulge": 1.5}, "'bulge' .* must be at most 1, not 1.5"),
        ({"radius": -1}, "'radius' .* must be a number from 0, not -1"),
        ({"count": 0}, "count must be a whole number from 1, not 0"),
        ({"count": 2**31}, "2,147,483,648 spheres are too many"),
    ):
        with pytest.raises(ConfigError, match=message):
            make_spheres(**{"name": "galaxy", "count": 10, **arguments})

    def refuse(subject, needed_bytes, error):
        raise error(f"{subject} need {needed_bytes}")

    monkeypatch.setattr(module, "check_memory", refuse)
    monkeypatch.setitem(SPHERE_SETS, "galaxy", lambda count, generator: pytest.fail("it was made"))
    with pytest.raises(ConfigError, match="1,000,000 spheres need 300000000"):
        make_spheres("galaxy", count=10**6)
