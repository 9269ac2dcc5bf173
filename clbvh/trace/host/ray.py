"""One ray on the host, to the last bit as on the device: its shear, its padding, and its crossing with a triangle.

Shared by the loops that traverse trees on the host.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...support.compiled import compiled
from ...support.fused import fused

_ROUNDING = 2.0**-24


def _error_bound(roundings: int) -> np.float32:
    return np.float32(roundings * _ROUNDING / (1 - roundings * _ROUNDING))


# The constants of cl/boxes/padding.cl.
_AXIS_PADDING = _error_bound(14)
_TIME_PADDING = _error_bound(28)
_LARGEST_COORDINATE = np.float32(1.0)
_MIN_SLOPE = np.float32(2.0**-30)

_ZERO, _ONE, _TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)


class HostRay(NamedTuple):
    """A ray made ready for boxes and triangles; three float32 each, per axis, unless stated.

    Attributes
    ----------
    near_origin, far_origin : where the near and the far planes of boxes are seen from
    inverse : of the direction
    axes : 3 int64, those that become x, y and z
    origin : permuted by `axes`
    shear : makes the ray the z axis
    perturbation : 2 float32
    """

    near_origin: tuple[Any, Any, Any]
    far_origin: tuple[Any, Any, Any]
    inverse: tuple[Any, Any, Any]
    axes: tuple[int, int, int]
    origin: tuple[Any, Any, Any]
    shear: tuple[Any, Any, Any]
    perturbation: tuple[Any, Any]


@compiled(error_model="numpy", is_inlined=True)
def make_host_ray(origin, direction):
    """Return a `HostRay` of 3 float32 each; see `make_ray` in cl/rays/ray.cl and `pad_ray` in cl/boxes.

    Everything is a number or a tuple of them, which stay in registers.
    """
    x, y, z = abs(direction[0]), abs(direction[1]), abs(direction[2])
    z_axis = (0 if x > z else 2) if x > y else (1 if y > z else 2)
    x_axis = 0 if z_axis == 2 else z_axis + 1
    y_axis = 0 if x_axis == 2 else x_axis + 1
    along = pick(direction, z_axis)
    shear = pick(direction, x_axis) / along, pick(direction, y_axis) / along, _ONE / along
    point = pick(origin, x_axis), pick(origin, y_axis), pick(origin, z_axis)
    perturbation = -point[0] - shear[0] * -point[2], -point[1] - shear[1] * -point[2]

    longest_reach = abs(point[2]) + _LARGEST_COORDINATE
    distance = _TWO * _MIN_SLOPE * longest_reach
    time = _TIME_PADDING * longest_reach * abs(shear[2])
    near_x, far_x, inverse_x = _pad_axis(origin[0], direction[0], distance, time)
    near_y, far_y, inverse_y = _pad_axis(origin[1], direction[1], distance, time)
    near_z, far_z, inverse_z = _pad_axis(origin[2], direction[2], distance, time)
    return HostRay(
        (near_x, near_y, near_z), (far_x, far_y, far_z), (inverse_x, inverse_y, inverse_z), (x_axis, y_axis, z_axis),
        point, shear, perturbation,
    )  # fmt: skip


@compiled(error_model="numpy")
def _pad_axis(origin, direction, distance, time):
    """Return the origins from which near and far planes are seen on one axis, and the inverse of the direction."""
    inverse = _ONE / direction
    width = _AXIS_PADDING * (abs(origin) + _LARGEST_COORDINATE) + distance + time * abs(direction)
    ahead = -width if inverse < _ZERO else width
    return origin + ahead, origin - ahead, inverse


@compiled(error_model="numpy")
def pick(values, axis):
    """Return one of three numbers: selections, where an index would become branches."""
    return values[0] if axis == 0 else values[1] if axis == 1 else values[2]


@compiled(error_model="numpy", is_inlined=True)
def shear_corner(corner, ray):
    """Return a corner of a triangle, whose axes are permuted as the ray's, as the ray sees it."""
    x, y, z = corner[0] - ray.origin[0], corner[1] - ray.origin[1], corner[2] - ray.origin[2]
    return x - ray.shear[0] * z, y - ray.shear[1] * z, ray.shear[2] * z


@compiled(error_model="numpy", is_inlined=True)
def cross_corners(a, b, c, perturbation):
    """Return t where the ray crosses the triangle of three sheared corners, NaN if it does not: the device's bits."""
    edge_a, edge_b, edge_c = _edge(c[0], b[1], c[1], b[0]), _edge(a[0], c[1], a[1], c[0]), _edge(b[0], a[1], b[1], a[0])
    area = edge_a + edge_b + edge_c
    side_a = _side_of_edge(edge_a, b, c, perturbation)
    side_b = _side_of_edge(edge_b, c, a, perturbation)
    side_c = _side_of_edge(edge_c, a, b, perturbation)
    is_left = side_a < _ZERO or side_b < _ZERO or side_c < _ZERO
    is_right = side_a > _ZERO or side_b > _ZERO or side_c > _ZERO
    if (is_left and is_right) or area == _ZERO:
        return np.float32(np.nan)
    return (edge_a * a[2] + edge_b * b[2] + edge_c * c[2]) / area


@compiled(error_model="numpy")
def _side_of_edge(edge, begin, end, perturbation):
    """Return the edge function, and where it is zero, that of the perturbed ray."""
    if edge != _ZERO:
        return edge
    along_x, along_y = end[0] - begin[0], end[1] - begin[1]
    perturbed = _edge(perturbation[0], along_y, perturbation[1], along_x)
    if perturbed != _ZERO:
        return perturbed
    return along_y if along_y != _ZERO else -along_x


@compiled(error_model="numpy")
def _edge(a, b, c, d):
    """Return a * b - c * d as `difference_of_products` in cl/triangles/triangle.cl."""
    rounded = c * d
    return fused(a, b, -rounded) + fused(-c, d, rounded)
