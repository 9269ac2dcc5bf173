"""Distances of triangles, boxes, spheres and ellipsoids, alone, in lanes and placed by any affine map, in float64."""

import numpy as np
import pytest

from clbvh import Spheres
from clbvh.kinds import ALL_KINDS, SPHERES
from clbvh.structs import INSTANCE
from clbvh.trace.world.metrics import make_metrics
from clbvh.trace.world.surface_arrays import make_surface_arrays
from clbvh.tree_layouts import LAYOUTS, WIDE_LAYOUTS

from ..unit.trace.scene_distances import distance_to_ellipsoid

pytestmark = pytest.mark.on_both

COUNT = 24_000
ROUNDING = 2.0**-24

# Roundings of the distance, relative to the farthest corner: seven of the weighted sum of corners and three of its
# length, see NEAREST_SLACK in cl/nearest/search.cl.
ROUNDINGS = 10


def make_corners(generator):
    """(5 n, 3, 3) float32 around zero."""
    alike, far, small, sliver = generator.uniform(-1, 1, (4, COUNT, 3, 3))
    far += generator.normal(size=(COUNT, 1, 3))
    small = generator.normal(size=(COUNT, 1, 3)) + 10.0 ** generator.uniform(-6, 0, (COUNT, 1, 1)) * small
    beside = 10.0 ** generator.uniform(-9, -2, (COUNT, 1)) * generator.normal(size=(COUNT, 3))
    fraction = generator.uniform(-0.5, 1.5, (COUNT, 1))
    sliver[:, 2] = sliver[:, 0] + fraction * (sliver[:, 1] - sliver[:, 0]) + beside
    # Lines, points, and zero on corners, edges and in the plane.
    grid = generator.integers(-2, 3, (COUNT, 3, 3))
    return np.concatenate((alike, far, small, sliver, grid)).astype(np.float32)


def dot(a, b):
    return (a * b).sum(axis=-1)


def distance_to_segment(a, b):
    along = b - a
    squared = dot(along, along)
    fraction = np.clip(np.divide(-dot(a, along), squared, out=np.zeros(len(a)), where=squared > 0), 0, 1)
    return np.linalg.norm(a + fraction[:, None] * along, axis=1)


def measure(corners):
    """The distance from the plane where the foot is inside, else that from the nearest edge."""
    a, b, c = corners.astype(np.float64).transpose(1, 0, 2)
    sides = ((a, b), (b, c), (c, a))
    edges = np.min([distance_to_segment(*side) for side in sides], axis=0)
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    inside = np.stack([dot(np.cross(end - begin, -begin), normal) for begin, end in sides])
    with np.errstate(invalid="ignore", divide="ignore"):
        plane = np.abs(dot(a, normal)) / length
    return np.where((inside >= 0).all(axis=0) & (length > 0), np.minimum(plane, edges), edges)


def measure_on_device(call, corners):
    """Squared distances of triangles from zero."""
    body = """
        const point_t first = {a.x, a.y, a.z}, second = {b.x, b.y, b.z}, third = {c.x, c.y, c.z};
        square = distance_squared_to_triangle(first, second, third);
    """
    a, b, c = corners.transpose(1, 0, 2)
    return call("nearest/point_triangle.cl", body, "float square", a=a, b=b, c=c)


@pytest.fixture(scope="module")
def triangles(call):
    """Corners, and the squared distances from zero on the device."""
    corners = make_corners(np.random.default_rng(75))
    return corners, measure_on_device(call, corners)


def test_distances_of_triangles_are_those_of_float64(triangles):
    corners, squares = triangles
    farthest = np.linalg.norm(corners.astype(np.float64), axis=2).max(axis=1)
    error = np.abs(np.sqrt(squares.astype(np.float64)) - measure(corners))
    assert (error <= ROUNDINGS * ROUNDING * farthest).all()


def test_the_order_of_corners_changes_no_edge(triangles, call):
    """Two triangles that share an edge are equally far where it is nearest, whatever the order of their corners."""
    a, b, _ = triangles[0].transpose(1, 0, 2)
    # Zero is in the plane, beyond the edge from a to b.
    is_flat = np.linalg.norm(np.cross(a, b), axis=1) <= 0.01 * np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    beyond = np.stack((a, b, 5 * (a + b)), axis=1)[~is_flat]
    turned = measure_on_device(call, beyond[:, [1, 0, 2]])
    assert measure_on_device(call, beyond).tobytes() == turned.tobytes()


@pytest.mark.parametrize("portable", [{}, {"PORTABLE": 1}], ids=["built-in", "portable"])
@pytest.mark.parametrize("layout", WIDE_LAYOUTS)
def test_lanes_have_the_same_bits(triangles, call, layout, portable):
    corners, squares = triangles
    width = LAYOUTS[layout].width
    body = """
        point_t points[3];
        for (int corner = 0; corner < 3; corner++) {
            points[corner].x = load_lanes(corners + 3 * WIDTH * corner);
            points[corner].y = load_lanes(corners + 3 * WIDTH * corner + WIDTH);
            points[corner].z = load_lanes(corners + 3 * WIDTH * corner + 2 * WIDTH);
        }
        squares = distance_squared_to_triangle(points[0], points[1], points[2]);
    """
    blocks = corners.reshape(-1, width, 3, 3).transpose(0, 2, 3, 1)
    includes, outputs = "traversal/traverse.cl nearest/point_triangle.cl", f"float{width} squares"
    lanes = call(includes, body, outputs, corners=blocks, layout=layout, defines=portable)
    assert lanes.ravel().tobytes() == squares.tobytes()


DEFINES = {"LONE": 0, "KINDS": ALL_KINDS}
PLACES = 4000


def test_distances_of_what_an_instance_places(call):
    generator = np.random.default_rng(1420)
    # Sheared, flat, tiny, and every other one a mirror.
    maps, others = (np.linalg.qr(generator.normal(size=(PLACES, 3, 3)))[0] for _ in range(2))
    sizes = 10.0 ** (generator.uniform(-1, 1, (PLACES, 3)) + generator.uniform(-12, 0, (PLACES, 1)))
    sizes[::3, 2] *= 1e-4
    maps[::2, :, 0] *= -1
    maps, centres = (maps * sizes[:, None]) @ others, generator.uniform(-1, 1, (PLACES, 3))
    instances = np.zeros(PLACES, INSTANCE)
    instances["to_world"], instances["kind"], instances["centre"] = maps, SPHERES.number, centres
    instances["centre_low"] = centres - instances["centre"]
    instances["radius"] = radius = np.linalg.norm(maps, axis=(1, 2))
    away = 10.0 ** generator.uniform(-2, 3, (PLACES, 1)) * generator.normal(size=(PLACES, 3)) * radius[:, None]
    positions = (centres + away).astype(np.float32)
    boxes = np.sort(generator.uniform(-1, 1, (PLACES, 2, 3)).astype(np.float32), axis=1)
    shares = generator.uniform(size=(PLACES, 3))
    inside = np.clip(boxes[:, 0] + shares * (boxes[:, 1] - boxes[:, 0]), boxes[:, 0], boxes[:, 1]).astype(np.float32)
    radii = (10.0 ** generator.uniform(-3, 0, PLACES)).astype(np.float32)
    # The metrics of geometries and a scene that are in their local coordinates.
    arrays = make_surface_arrays([Spheres([[0, 0, 0]], 1)], np.zeros(PLACES, int), np.tile(np.eye(4), (PLACES, 1, 1)))
    metrics = make_metrics(arrays._replace(linear=maps, scale=np.ones(1)), 1.0).records
    body = """
        const point_pair_t point = {position, (float3)(0.0f), 0};
        const float3 way = way_to_instance(instance, &point);
        const nearest_t nearest = make_nearest(make_metric(instance, metric, way, false, (float3)(0.0f)), KIND_SPHERES);
        const float unit = nearest.metric.unit;
        const point_t least = {low.x, low.y, low.z}, greatest = {high.x, high.y, high.z};
        const point_t outside = way_to_box(&nearest.metric, least, greatest);
        to_box = sqrt(dot_of(outside, outside)) / unit;
        slack = nearest.metric.slack / unit;
        const point_t placed = place_point(&nearest.metric, inside.x, inside.y, inside.z);
        to_corner = sqrt(dot_of(placed, placed)) / unit;
        const point_t centre = {inside.x, inside.y, inside.z};
        to_sphere = sqrt(distance_squared_to_sphere(&nearest, centre, radius)) / unit;
    """
    includes, outputs = (
        "spheres/distance.cl points/point.cl",
        "float to_box, float slack, float to_corner, float to_sphere",
    )
    found = call(includes, body, outputs,
                 instance=instances, metric=metrics, position=positions, low=boxes[:, 0], high=boxes[:, 1],
                 inside=inside, radius=radii, defines=DEFINES)  # fmt: skip
    to_box, slack, to_corner, to_sphere = np.float64(found)

    # The map as the device has it.
    linear = instances["to_world"].astype(np.float64)
    offset = instances["centre"].astype(np.float64) + instances["centre_low"] - positions.astype(np.float64)
    reach = np.abs(linear).sum(axis=(1, 2)) + np.abs(offset).sum(axis=1)

    def far(points):
        return np.linalg.norm(np.einsum("nij,nj->ni", linear, points.astype(np.float64)) + offset, axis=1)

    assert (np.abs(to_corner - far(inside)) <= 10 * ROUNDING * reach).all()
    # A box is never too far.
    corners = [np.where(choice, boxes[:, 0], boxes[:, 1]) for choice in np.ndindex(2, 2, 2)]
    nearest = np.min([far(points) for points in (inside, *corners)], axis=0)
    assert (to_box <= np.minimum(nearest, to_corner) + slack).all()
    assert (slack <= 65 * ROUNDING * reach).all()
    # And not much too near: by the size of the placed box.
    size = np.linalg.norm(np.abs(linear) @ (boxes[:, 1] - boxes[:, 0])[..., None], axis=(1, 2))
    assert (to_box >= nearest - 2 * size - slack).all()
    # Spheres are ellipsoids.
    for i in range(0, PLACES, 8):
        centre = linear[i] @ inside[i] + offset[i]
        expected = distance_to_ellipsoid(np.zeros((1, 3)), centre, linear[i] * np.float64(radii[i]))[0]
        assert abs(to_sphere[i] - expected) <= 32 * ROUNDING * reach[i]
