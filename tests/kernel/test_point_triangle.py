"""The distance of a triangle against float64, and the same bits for single triangles and in lanes."""

import numpy as np
import pytest

from clbvh.structs import LAYOUT_WIDTHS

from .test_slabs import LAYOUT_NAMES

COUNT = 24_000

# Roundings of the distance, relative to the farthest corner: seven of the weighted sum of corners and three of its
# length, see NEAREST_SLACK in cl/nearest/search.cl.
ROUNDINGS = 10
ROUNDING = 2.0**-24


def make_triangles(kind, generator):
    """(n, 3, 3) float32 around zero."""
    if kind == "any":
        corners = generator.uniform(-1, 1, (COUNT, 3, 3))
    elif kind == "far":
        corners = generator.uniform(-1, 1, (COUNT, 3, 3)) + generator.normal(size=(COUNT, 1, 3))
    elif kind == "small":
        size = 10.0 ** generator.uniform(-6, 0, (COUNT, 1, 1))
        corners = generator.normal(size=(COUNT, 1, 3)) + size * generator.uniform(-1, 1, (COUNT, 3, 3))
    elif kind == "sliver":
        corners = generator.uniform(-1, 1, (COUNT, 3, 3))
        fraction = generator.uniform(-0.5, 1.5, (COUNT, 1))
        corners[:, 2] = corners[:, 0] + fraction * (corners[:, 1] - corners[:, 0])
        corners[:, 2] += 10.0 ** generator.uniform(-9, -2, (COUNT, 1)) * generator.normal(size=(COUNT, 3))
    else:
        # Lines, points, and zero on corners, edges and in the plane.
        corners = generator.integers(-2, 3, (COUNT, 3, 3)).astype(float)
    return corners.astype(np.float32)


KINDS = ["any", "far", "small", "sliver", "grid"]


def dot(a, b):
    return (a * b).sum(axis=-1)


def distance_to_segment(a, b):
    along = b - a
    squared = dot(along, along)
    fraction = np.clip(np.divide(-dot(a, along), squared, out=np.zeros(len(a)), where=squared > 0), 0, 1)
    return np.linalg.norm(a + fraction[:, None] * along, axis=1)


def measure(corners):
    """The oracle in float64: the distance from the plane where the foot is inside, else that from the nearest edge."""
    a, b, c = corners.astype(np.float64).transpose(1, 0, 2)
    edges = np.minimum(np.minimum(distance_to_segment(a, b), distance_to_segment(b, c)), distance_to_segment(c, a))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    inside = np.stack([dot(np.cross(end - begin, -begin), normal) for begin, end in ((a, b), (b, c), (c, a))])
    with np.errstate(invalid="ignore", divide="ignore"):
        plane = np.abs(dot(a, normal)) / length
    return np.where((inside >= 0).all(axis=0) & (length > 0), np.minimum(plane, edges), edges)


@pytest.fixture(scope="module", params=KINDS)
def measured(request, run_shell):
    """Triangles, and their squared distances from zero on the device."""
    corners = make_triangles(request.param, np.random.default_rng([75, KINDS.index(request.param)]))
    (squares,) = run_shell("measure_triangles", [corners], [np.float32])
    return corners, squares


def test_distances_are_those_of_float64(measured):
    corners, squares = measured
    expected = measure(corners)
    farthest = np.linalg.norm(corners.astype(np.float64), axis=2).max(axis=1)
    error = np.sqrt(squares.astype(np.float64)) - expected
    bound = ROUNDINGS * ROUNDING * farthest
    assert (error >= -bound).all()
    assert (error <= bound).all()


def test_the_order_of_corners_changes_no_edge(measured, run_shell):
    """Two triangles that share an edge are equally far where it is nearest, whatever the order of their corners."""
    corners, _ = measured
    a, b = corners[:, 0], corners[:, 1]
    # Zero is in the plane, beyond the edge from a to b.
    is_flat = np.linalg.norm(np.cross(a, b), axis=1) <= 0.01 * np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    beyond = np.stack((a, b, 5 * (a + b)), axis=1)[~is_flat]
    assert len(beyond) > COUNT / 4
    results = [run_shell("measure_triangles", [beyond[:, order]], [np.float32])[0] for order in ([0, 1, 2], [1, 0, 2])]
    assert results[0].tobytes() == results[1].tobytes()


@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_lanes_have_the_same_bits(measured, run_lane_shell, layout, portable):
    corners, squares = measured
    width = LAYOUT_WIDTHS[layout]
    blocks = np.ascontiguousarray(corners.reshape(-1, width, 3, 3).transpose(0, 2, 3, 1))
    (lanes,) = run_lane_shell(layout, "measure_lanes", [blocks], [(np.float32, (width,))], portable=portable)
    assert lanes.ravel().tobytes() == squares.tobytes()
