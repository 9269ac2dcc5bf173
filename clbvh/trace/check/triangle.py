"""One triangle against one ray, in float64: surely hit, surely missed, or too close to call.

An orthonormal frame of the ray instead of the device's shear.
"""

from __future__ import annotations

import numpy as np

from ...support.compiled import compiled

# A component of a normal is a difference of two products, each of two edges: float64 rounds it by this share of the
# square of the largest edge at most.
_NORMAL_ROUNDING = 2.0**-50


@compiled
def make_frame(direction, frame):
    """Write an orthonormal frame whose last row is the direction, normalised; return the direction's length."""
    length = np.sqrt((direction**2).sum())
    along = direction / length
    # Any axis that is far from parallel to the ray gives a stable first cross product.
    axis = np.argmin(np.abs(along))
    helper = np.zeros(3)
    helper[axis] = 1.0
    frame[2] = along
    frame[0] = np.cross(helper, along)
    frame[0] /= np.sqrt((frame[0] ** 2).sum())
    frame[1] = np.cross(along, frame[0])
    return length


@compiled
def project(vertices, vertex, origin, frame):
    """Return a corner's coordinates in the ray's frame: two across the ray, one along it."""
    x = vertices[vertex, 0] - origin[0]
    y = vertices[vertex, 1] - origin[1]
    z = vertices[vertex, 2] - origin[2]
    return (
        x * frame[0, 0] + y * frame[0, 1] + z * frame[0, 2],
        x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2],
        x * frame[2, 0] + y * frame[2, 1] + z * frame[2, 2],
    )


@compiled
def judge_triangle(a, b, c, blur, verdict):
    """Test one triangle against the ray along the z axis from zero.

    Parameters
    ----------
    a, b, c : tuples of 3 float64
        The corners in the ray's frame, see `project`.
    blur : float64
        How far the device may see each corner from where it is, across the ray and along it.
    verdict : (4,) float64, written
        1 surely hit, 0 too close to call, -1 surely missed; the distance along the ray; and the least and the greatest
        distance that the device may find. A triangle that is surely missed leaves the last three alone.

    Notes
    -----
    While the corners move by up to the blur, a ray that is farther than that from all edges stays on its side of them.
    A point of the moved triangle has moved by no more than the blur either. So a hit is at the height of a point of
    the exact triangle that is as near to the ray, give or take the blur. Both hold for slivers thinner than the blur.
    """
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a, b, c
    verdict[0] = -1.0
    if min(ax, bx, cx) > blur or max(ax, bx, cx) < -blur or min(ay, by, cy) > blur or max(ay, by, cy) < -blur:
        return

    # On which side of the edges does the ray pass, and how far from them?
    side_a, side_b, side_c = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
    is_beside = (side_a < 0.0 or side_b < 0.0 or side_c < 0.0) and (side_a > 0.0 or side_b > 0.0 or side_c > 0.0)
    nearest = min(
        _distance_to_segment(bx, by, cx, cy), _distance_to_segment(cx, cy, ax, ay), _distance_to_segment(ax, ay, bx, by)
    )
    if is_beside and nearest > blur:
        return
    verdict[0] = 1.0 if nearest > blur else 0.0

    # Where does it cross the plane? A triangle that is seen edge-on is crossed anywhere between its corners.
    nx = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
    ny = (bz - az) * (cx - ax) - (bx - ax) * (cz - az)
    nz = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    low, high = min(az, bz, cz), max(az, bz, cz)
    verdict[1], verdict[2], verdict[3] = (low + high) / 2, low - blur, high + blur
    if nz != 0.0:
        # A shift along the ray, and one across it, which a slanted plane turns into one along it.
        height = (nx * ax + ny * ay + nz * az) / nz
        slant = np.sqrt(nx * nx + ny * ny + nz * nz) / abs(nz)
        slack = blur * (1.0 + slant)
        # Of corners that are nearly in one line, float64 itself rounds the normal off.
        reach = max(abs(ax), abs(ay), abs(bx), abs(by), abs(cx), abs(cy)) + (high - low)
        slack += _NORMAL_ROUNDING * reach * reach / abs(nz) * (1.0 + slant) * reach
        verdict[1] = min(max(height, low), high)
        verdict[2], verdict[3] = max(height - slack, low - blur), min(height + slack, high + blur)


@compiled
def _distance_to_segment(ax, ay, bx, by):
    """Return the distance of zero from the segment between two points."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    share = min(max(-(ax * dx + ay * dy) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return np.hypot(ax + share * dx, ay + share * dy)
