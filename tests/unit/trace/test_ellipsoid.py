"""The closest point of an ellipsoid."""

import numpy as np
import pytest

from clbvh.trace.points.ellipsoid import find_shares

from .scene_distances import distance_to_ellipsoid

COUNT = 300


def make_lengths(kind, generator):
    lengths = 10.0 ** generator.uniform(-1, 1, 3)
    if kind == "sphere":
        lengths[:] = lengths[0]
    elif kind == "oblate":
        lengths[1] = lengths[0] = 2 * lengths[2]
    elif kind == "needle":
        lengths *= [1, 1e-5, 1e-5]
    elif kind == "flat":
        lengths *= [1, 1, 1e-7]
    return generator.permutation(lengths)


def make_positions(lengths, generator):
    """Points around, close to the surface, within, and on planes and axes of symmetry."""
    anywhere = generator.normal(size=(COUNT, 3)) * lengths.max() * 10.0 ** generator.uniform(-6, 2, (COUNT, 1))
    directions = generator.normal(size=(COUNT, 3))
    surface = directions / np.linalg.norm(directions, axis=1, keepdims=True) * lengths
    points = np.abs(np.concatenate((anywhere, surface, surface * (1 + 1e-6 * generator.normal(size=(COUNT, 1))))))
    points[::4, 0] = 0
    points[::5, 1] = 0
    points[::6, 2] = 0
    return points


@pytest.mark.parametrize("kind", ["any", "sphere", "oblate", "needle", "flat"])
@pytest.mark.parametrize("seed", [1300, 1301, 1302])
def test_points_are_the_closest(kind, seed):
    generator = np.random.default_rng(seed)
    lengths = make_lengths(kind, generator)
    positions = make_positions(lengths, generator)
    shares = np.empty_like(positions)
    for position, share in zip(positions, shares, strict=True):
        find_shares(position, lengths, share)
    np.testing.assert_allclose(np.linalg.norm(shares, axis=1), 1, rtol=0, atol=1e-15)
    assert (shares >= 0).all()
    distance = np.linalg.norm(positions - shares * lengths, axis=1)
    expected = distance_to_ellipsoid(positions, np.zeros(3), np.diag(lengths))
    reach = np.maximum(np.linalg.norm(positions, axis=1), lengths.max())
    assert (np.abs(distance - expected) <= 4e-15 * reach).all()


def test_the_middle_is_nearest_to_an_end_of_the_shortest_axis():
    shares = np.empty(3)
    find_shares(np.zeros(3), np.array([3.0, 1.0, 2.0]), shares)
    assert shares.tolist() == [0, 1, 0]
    find_shares(np.zeros(3), np.full(3, 2.0), shares)
    assert shares.tolist() == [1, 0, 0]
