"""Distances within placed geometries against float64: of boxes, corners and spheres under any affine map."""

import numpy as np
import pytest

from clbvh import Spheres
from clbvh.structs import INSTANCE, LAYOUTS, PRIM_KINDS
from clbvh.trace.world.metrics import make_metrics
from clbvh.trace.world.surface_arrays import make_surface_arrays

from ..unit.trace.scene_distances import distance_to_ellipsoid

COUNT = 4000
ROUNDING = 2.0**-24

BUNDLE = "placed_shells"
DEFINES = {"LAYOUT": LAYOUTS["brute"], "LONE": 0, "HAS_SPHERES": 1}

KINDS = ["similar", "scale", "shear", "flat"]


def make_maps(kind, generator):
    """(n, 3, 3) float64."""
    rotations, others = (np.linalg.qr(generator.normal(size=(COUNT, 3, 3)))[0] for _ in range(2))
    sizes = 10.0 ** generator.uniform(-1, 1, (COUNT, 3))
    rotations[:, :, 0] *= generator.choice([-1, 1], (COUNT, 1))  # every other one is a mirror
    if kind == "similar":
        sizes[:] = sizes[:, :1]
    if kind == "flat":
        sizes *= [1, 1, 1e-4]
    maps = rotations * sizes[:, None] * 10.0 ** generator.uniform(-12, 0, (COUNT, 1, 1))
    return maps if kind in ("similar", "scale") else maps @ others


def make_records(maps):
    """The metrics of geometries and a scene that are in their local coordinates."""
    arrays = make_surface_arrays(
        [Spheres([[0, 0, 0]], 1)], np.zeros(len(maps), int), np.tile(np.eye(4), (len(maps), 1, 1))
    )
    return make_metrics(arrays._replace(linear=maps, scale=np.ones(1)), 1.0).records


@pytest.fixture(scope="module", params=KINDS)
def measured(request, run_shell):
    """The inputs in float64, and what the device makes of them."""
    generator = np.random.default_rng([1420, KINDS.index(request.param)])
    maps = make_maps(request.param, generator)
    instances = np.zeros(COUNT, INSTANCE)
    radius = np.linalg.norm(maps, axis=(1, 2))
    centres = generator.uniform(-1, 1, (COUNT, 3))
    instances["to_world"], instances["radius"], instances["kind"] = maps, radius, PRIM_KINDS["spheres"]
    instances["centre"] = centres
    instances["centre_low"] = centres - instances["centre"]
    away = 10.0 ** generator.uniform(-2, 3, (COUNT, 1)) * generator.normal(size=(COUNT, 3)) * radius[:, None]
    positions = (centres + away).astype(np.float32)
    corners = generator.uniform(-1, 1, (COUNT, 2, 3)).astype(np.float32)
    boxes = np.sort(corners, axis=1)
    shares = generator.uniform(size=(COUNT, 3))
    inside = np.clip(boxes[:, 0] + shares * (boxes[:, 1] - boxes[:, 0]), boxes[:, 0], boxes[:, 1]).astype(np.float32)
    radii = (10.0 ** generator.uniform(-3, 0, COUNT)).astype(np.float32)
    results = run_shell(
        "measure_placed",
        [instances, make_records(maps), positions, boxes, inside, radii],
        [np.float32] * 4,
        BUNDLE,
        DEFINES,
    )
    # The map as the device has it.
    linear = instances["to_world"].astype(np.float64)
    centre = instances["centre"].astype(np.float64) + instances["centre_low"]
    offset = centre - positions.astype(np.float64)
    reach = np.abs(linear).sum(axis=(1, 2)) + np.abs(offset).sum(axis=1)
    return request.param, linear, offset, boxes, inside, radii, reach, [result.astype(np.float64) for result in results]


def test_corners_are_placed(measured):
    _, linear, offset, _, inside, _, reach, (_, _, to_corner, _) = measured
    expected = np.linalg.norm(np.einsum("nij,nj->ni", linear, inside.astype(np.float64)) + offset, axis=1)
    assert (np.abs(to_corner - expected) <= 10 * ROUNDING * reach).all()


def test_boxes_are_never_too_far(measured):
    kind, linear, offset, boxes, inside, _, reach, (to_box, slack, to_corner, _) = measured
    # Points of the box, among them its corners.
    points = [inside, *(np.where(choice, boxes[:, 0], boxes[:, 1]) for choice in np.ndindex(2, 2, 2))]
    placed = [np.einsum("nij,nj->ni", linear, point.astype(np.float64)) + offset for point in points]
    nearest = np.min([np.linalg.norm(point, axis=1) for point in placed], axis=0)
    assert (to_box <= nearest + slack).all()
    assert (to_box <= to_corner + slack).all()
    assert (slack <= 65 * ROUNDING * reach).all()
    # And not much too near: by the size of the placed box.
    size = np.linalg.norm(np.abs(linear) @ (boxes[:, 1] - boxes[:, 0])[..., None], axis=(1, 2))
    assert (to_box >= nearest - 2 * size - slack).all()
    if kind in ("similar", "scale"):
        # Exact where the map scales along the local axes: in these, the box is still one.
        lengths = np.linalg.norm(linear, axis=1)
        point = -np.einsum("nij,nj->ni", np.linalg.inv(linear), offset)
        outside = np.maximum(np.maximum(boxes[:, 0] - point, point - boxes[:, 1]), 0) * lengths
        assert (np.abs(to_box - np.linalg.norm(outside, axis=1)) <= slack).all()


def test_spheres_are_ellipsoids(measured):
    _, linear, offset, _, inside, radii, reach, (_, _, _, to_sphere) = measured
    for i in range(0, COUNT, 8):
        centre = linear[i] @ inside[i] + offset[i]
        expected = distance_to_ellipsoid(np.zeros((1, 3)), centre, linear[i] * np.float64(radii[i]))[0]
        assert abs(to_sphere[i] - expected) <= 32 * ROUNDING * reach[i]


@pytest.mark.parametrize("seed", [1430, 1431])
def test_ellipsoids_of_any_shape(run_shell, seed):
    generator = np.random.default_rng(seed)
    lengths = (10.0 ** generator.uniform(-4, 0, (COUNT, 3))).astype(np.float32)
    positions = np.abs(generator.normal(size=(COUNT, 3)) * 10.0 ** generator.uniform(-6, 1, (COUNT, 1)))
    positions[::4, 0] = positions[::5, 1] = positions[::6, 2] = 0
    positions = positions.astype(np.float32)
    (squares,) = run_shell("measure_ellipsoids", [positions, lengths], [np.float32], BUNDLE, DEFINES)
    for i in range(0, COUNT, 8):
        expected = distance_to_ellipsoid(
            positions[i : i + 1].astype(np.float64), np.zeros(3), np.diag(np.float64(lengths[i]))
        )[0]
        reach = np.float64(max(lengths[i].max(), positions[i].max()))
        assert abs(np.sqrt(np.float64(squares[i])) - expected) <= 32 * ROUNDING * reach
