"""The procedural meshes: size, closedness, orientation, repeatability."""

from __future__ import annotations

import time

import numpy as np
import pytest

from clbvh import Mesh
from clbvh.errors import ConfigError
from clbvh.geometry.shapes.make_shape import SHAPES, make_shape

CLOSED = ("knot", "blobs", "boxes", "icosphere", "cube")
# Of one size, whatever number of triangles is wanted.
FIXED = {"square": 2, "cube": 12}


def is_closed(mesh: Mesh) -> bool:
    """Return whether each edge has exactly one triangle on either side, wound alike."""
    begin = mesh.faces.ravel().astype(np.int64)
    end = np.roll(mesh.faces, -1, axis=1).ravel().astype(np.int64)
    forth = np.sort(begin * len(mesh.vertices) + end)
    back = np.sort(end * len(mesh.vertices) + begin)
    return bool((np.diff(forth) > 0).all() and (forth == back).all())


def volume_of(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->", np.cross(a, b), c) / 6)


@pytest.mark.parametrize("seed", [0, 5])
@pytest.mark.parametrize("triangles", [162, 1000, 20_011])
@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_sound(name, triangles, seed):
    mesh = make_shape(name, triangles=triangles, seed=seed)
    assert FIXED.get(name, triangles // 4 + 1) <= mesh.face_count <= FIXED.get(name, triangles)
    assert mesh.degenerate_count == 0
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    assert is_closed(mesh) == (name in CLOSED)
    if name in CLOSED:
        assert volume_of(mesh) > 0


@pytest.mark.parametrize("seed", [1])
@pytest.mark.parametrize("name", SHAPES)
def test_the_same_seed_gives_the_same_bytes(name, seed):
    first, second = (make_shape(name, triangles=3000, seed=seed) for _ in range(2))
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()
    other = make_shape(name, triangles=3000, seed=seed + 1)
    assert (other.vertices.tobytes() == first.vertices.tobytes()) == (name == "icosphere" or name in FIXED)


@pytest.mark.parametrize(
    ("name", "triangles", "delivered"),
    [
        ("knot", 871_200, 871_200),  # 2 x 1980 x 220
        ("knot", 162, 162),
        ("knot", 1001, 994),
        ("terrain", 2, 2),
        ("terrain", 1000, 968),
        ("blobs", 20, 20),
        ("blobs", 24_000, 24_000),  # 300 balls of 80
        ("boxes", 35, 24),
        ("icosphere", 20, 20),
        ("icosphere", 80, 80),
        ("icosphere", 499, 320),
        ("icosphere", 500, 500),
    ],
)
def test_how_many_triangles_are_delivered(name, triangles, delivered):
    assert make_shape(name, triangles=triangles).face_count == delivered


def test_squares_and_cubes_have_sides_of_1():
    square, cube = make_shape("square", triangles=2), make_shape("cube", triangles=12)
    assert square.vertices.max(axis=0).tolist() == [0.5, 0, 0.5]
    assert square.vertices.min(axis=0).tolist() == [-0.5, 0, -0.5]
    a, b, c = square.vertices[square.faces].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 1] > 0).all()
    assert volume_of(cube) == pytest.approx(1)
    for name, least in FIXED.items():
        with pytest.raises(ConfigError, match=f"needs at least {least} triangles, not {least - 1}"):
            make_shape(name, triangles=least - 1)


@pytest.mark.parametrize("name", sorted(SHAPES.keys() - FIXED.keys()))
def test_a_dragon_size_takes_seconds_at_most(name):
    begin = time.process_time()
    mesh = make_shape(name, triangles=871_200)
    assert mesh.face_count > 860_000
    assert time.process_time() - begin < 5  # about 0.8 s


def test_the_sphere_is_round():
    mesh = make_shape("icosphere", triangles=20 * 30**2)
    assert np.linalg.norm(mesh.vertices, axis=1) == pytest.approx(1, abs=1e-6)
    assert volume_of(mesh) == pytest.approx(4 / 3 * np.pi, rel=5e-3)
    edges = mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)]
    lengths = np.linalg.norm(edges, axis=2)
    assert lengths.max() < 2.2 * lengths.min()


def test_the_terrain_looks_up():
    mesh = make_shape("terrain", triangles=5000)
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    assert (np.cross(b - a, c - a)[:, 1] > 0).all()
    span = np.ptp(mesh.vertices, axis=0)
    assert span[[0, 2]] == pytest.approx(10)
    assert 0.5 < span[1] < 4


def test_a_finer_terrain_is_the_same_landscape():
    coarse, fine = (make_shape("terrain", triangles=2 * n * n, seed=4) for n in (64, 128))
    at = np.arange(0, 129, 2)
    heights = [mesh.vertices[:, 1].reshape(n + 1, n + 1) for mesh, n in ((coarse, 64), (fine, 128))]
    assert np.abs(heights[0] - heights[1][np.ix_(at, at)]).mean() < 0.03 * np.ptp(heights[1])


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
    assert np.ptp(make_shape("blobs", triangles=8000, spread=3).vertices) > 2 * np.ptp(
        make_shape("blobs", triangles=8000).vertices
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "teapot"}, "no shape 'teapot': take one of knot, terrain"),
        ({"name": "knot", "triangles": 161}, "'knot' needs at least 162 triangles, not 161"),
        ({"name": "terrain", "triangles": 1}, "needs at least 2"),
        ({"name": "icosphere", "triangles": 0}, "needs at least 20"),
        ({"name": "knot", "triangles": -5}, "triangles must be a whole number"),
        ({"name": "knot", "triangles": 1000.5}, "triangles must be a whole number"),
        ({"name": "knot", "triangles": True}, "triangles must be a whole number"),
        ({"name": "knot", "seed": -1}, "seed must be a whole number"),
        ({"name": "knot", "seed": "x"}, "seed must be a whole number"),
        ({"name": "knot", "height": 1}, "'knot' has no option 'height': it has turns, loops"),
        ({"name": "icosphere", "radius": 1}, "'icosphere' has no option 'radius': it has none"),
        ({"name": "terrain", "height": "tall"}, "'height' .* must be a number from 0, not 'tall'"),
        ({"name": "terrain", "height": float("nan")}, "must be a number from 0"),
        ({"name": "knot", "thickness": -1}, "must be a number from 0"),
        ({"name": "knot", "turns": 1.5}, "'turns' .* must be a whole number from 1"),
        ({"name": "knot", "strands": 0}, "'strands' .* must be a whole number from 1"),
        ({"name": "knot", "turns": 2, "loops": 4}, "no common divisor, but 2 and 4 do"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ConfigError, match=message):
        make_shape(**{"triangles": 1000, **arguments})
