"""One ray on the host, to the last bit as on the device: its shear, its padding, and its crossing with a triangle.

Shared by the loops that traverse trees on the host.
"""

from __future__ import annotations

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


@compiled(error_model="numpy")
def make_shear(origin, direction, shear, perturbation):
    """Write the shear that makes the ray the z axis, and the perturbation; return the axis that becomes z.

    See `make_ray` in cl/rays/ray.cl.
    """
    x, y, z = abs(direction[0]), abs(direction[1]), abs(direction[2])
    z_axis = (0 if x > z else 2) if x > y else (1 if y > z else 2)
    x_axis, y_axis = (z_axis + 1) % 3, (z_axis + 2) % 3
    along = direction[z_axis]
    shear[0], shear[1], shear[2] = direction[x_axis] / along, direction[y_axis] / along, _ONE / along
    perturbation[0] = -origin[x_axis] - shear[0] * -origin[z_axis]
    perturbation[1] = -origin[y_axis] - shear[1] * -origin[z_axis]
    return z_axis


@compiled(error_model="numpy")
def pad_ray(origin, direction, shear, z_axis, near_origin, far_origin, inverse):
    """Write the origins from which planes are seen, and the inverse of the direction; see `pad_ray` in cl/boxes."""
    longest_reach = abs(origin[z_axis]) + _LARGEST_COORDINATE
    distance = _TWO * _MIN_SLOPE * longest_reach
    time = _TIME_PADDING * longest_reach * abs(shear[2])
    for axis in range(3):
        inverse[axis] = _ONE / direction[axis]
        reach = abs(origin[axis]) + _LARGEST_COORDINATE
        width = _AXIS_PADDING * reach + distance + time * abs(direction[axis])
        ahead = -width if inverse[axis] < _ZERO else width
        near_origin[axis], far_origin[axis] = origin[axis] + ahead, origin[axis] - ahead


@compiled(error_model="numpy")
def cross_corners(ax, ay, az, bx, by, bz, cx, cy, cz, perturbation):
    """Return t where the ray crosses the triangle of three sheared vertices, NaN if it does not: the device's bits."""
    edge_a, edge_b, edge_c = _edge(cx, by, cy, bx), _edge(ax, cy, ay, cx), _edge(bx, ay, by, ax)
    area = edge_a + edge_b + edge_c
    side_a = _side_of_edge(edge_a, bx, by, cx, cy, perturbation)
    side_b = _side_of_edge(edge_b, cx, cy, ax, ay, perturbation)
    side_c = _side_of_edge(edge_c, ax, ay, bx, by, perturbation)
    is_left = side_a < _ZERO or side_b < _ZERO or side_c < _ZERO
    is_right = side_a > _ZERO or side_b > _ZERO or side_c > _ZERO
    if (is_left and is_right) or area == _ZERO:
        return np.float32(np.nan)
    return (edge_a * az + edge_b * bz + edge_c * cz) / area


@compiled(error_model="numpy")
def _side_of_edge(edge, begin_x, begin_y, end_x, end_y, perturbation):
    """Return the edge function, and where it is zero, that of the perturbed ray."""
    if edge != _ZERO:
        return edge
    along_x, along_y = end_x - begin_x, end_y - begin_y
    perturbed = _edge(perturbation[0], along_y, perturbation[1], along_x)
    if perturbed != _ZERO:
        return perturbed
    return along_y if along_y != _ZERO else -along_x


@compiled(error_model="numpy")
def _edge(a, b, c, d):
    """Return a * b - c * d as `difference_of_products` in cl/triangles/triangle.cl."""
    rounded = c * d
    return fused(a, b, -rounded) + fused(-c, d, rounded)
