"""Start points beside acute edges and corners: where the tracer can tell them from the walls around.

A start point is the centre of a ball that touches its triangle. Where no other triangle reaches into the ball, float32
cannot put the point behind any of them (docs/internals/offsets.md). Beside an acute edge the ball would reach through
the next wall, so the point on the triangle is moved away from there until the ball fits. The walls are the triangles
around the corners of the triangle that is left.
"""

from __future__ import annotations

import numpy as np

from ...support.compiled import compiled
from ...support.loop_functions import add_scaled, cross, dot, subtract
from ..clearance.triangles import measure_triangles
from .locations import make_normal

# A wall reaches into a ball only if it does by more than this share of the radius: those in the plane of a triangle
# touch its ball, but for rounding, and one at half a degree would reach in by three times that, from behind the point.
_SLACK = 2.0**-16

# A surface is no wall where it is no steeper beside a triangle: a start point is on the right side of it in any case,
# and its distance has room for three quarters of the height.
_LEAST_COSINE = 0.75

# Walls that rise less above a triangle, in sines of the angle, are taken for parts of its plane.
_LEAST_RISE = 2.0**-14

# The most room that a wall takes beside it, in radii: an edge of half a degree has no more.
_MOST_ROOM = 512.0

# A point is moved along its triangle by at most this, in local units: enough in a corner of half a degree. The step
# grows by this factor.
_MOST_MOVE = 2.0**-8
_STEP_GROWTH = 1.5

# The margin of a triangle without walls.
_NO_WALLS = -1.0


@compiled(error_model="numpy")
def make_room(vertices, faces, origin, scale, around, margins, rows, prim_ids, us, vs, is_front, heights):
    """Move points on triangles of a mesh away from walls that are too close.

    Parameters
    ----------
    vertices, faces, origin, scale, around
        Of the mesh; `around` are its `CornerFaces`.
    margins : (F, 4) float32, written
        See `SurfaceArrays`.
    rows : (m,) int64
        The points that are looked at, by their indices.
    prim_ids : (n,) int32
    us, vs : (n,) float64, written
    is_front : (n,) bool
    heights : (n,) float64, written
        Of the start points above them, in local units; 0 where no wall can be too close.
    """
    for row in rows:
        face, side, height = prim_ids[row], 0 if is_front[row] else 2, heights[row]
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        triangle = (
            _to_local(vertices, a, origin, scale), _to_local(vertices, b, origin, scale),
            _to_local(vertices, c, origin, scale),
        )  # fmt: skip
        x, y, z = make_normal(triangle[0], triangle[1], triangle[2], 1.0)
        normal = (x, y, z) if is_front[row] else (-x, -y, -z)
        if margins[face, side] == 0.0:
            if _find_least_cosine(vertices, faces, origin, scale, around, face, (x, y, z)) >= _LEAST_COSINE:
                margins[face] = _NO_WALLS
            else:
                walls = _find_walls(vertices, faces, origin, scale, around, face, (x, y, z))
                margins[face, side], margins[face, side + 1] = _find_margins(triangle, normal, walls)
        from_edge, from_corner = _find_distances(triangle, us[row], vs[row])
        if from_edge < margins[face, side] * height or from_corner < margins[face, side + 1] * height:
            walls = _find_walls(vertices, faces, origin, scale, around, face, (x, y, z))
            us[row], vs[row] = _find_place(triangle, normal, walls, height, us[row], vs[row])
        else:
            heights[row] = 0.0


@compiled
def _to_local(vertices, vertex, origin, scale):
    return (
        (vertices[vertex, 0] - origin[0]) * scale, (vertices[vertex, 1] - origin[1]) * scale,
        (vertices[vertex, 2] - origin[2]) * scale,
    )  # fmt: skip


@compiled
def _find_lengths(triangle):
    """Return the lengths of the edges opposite to the corners."""
    a, b, c = triangle
    ab, ac, bc = subtract(b, a), subtract(c, a), subtract(c, b)
    return np.sqrt(dot(bc, bc)), np.sqrt(dot(ac, ac)), np.sqrt(dot(ab, ab))


@compiled(error_model="numpy")
def _find_least_height(triangle):
    upright = cross(subtract(triangle[1], triangle[0]), subtract(triangle[2], triangle[0]))
    return np.sqrt(dot(upright, upright)) / max(_find_lengths(triangle))


@compiled(error_model="numpy")
def _find_distances(triangle, u, v):
    """Return how far a point of a triangle is from its edges and from its corners, in least heights of the triangle."""
    a, b, c = triangle
    of_a, of_b, of_c = _find_lengths(triangle)
    from_edge = min((1.0 - u - v) / of_a, u / of_b, v / of_c) * max(of_a, of_b, of_c)
    place = add_scaled(add_scaled(a, u, subtract(b, a)), v, subtract(c, a))
    to_a, to_b, to_c = subtract(a, place), subtract(b, place), subtract(c, place)
    from_corner = np.sqrt(min(dot(to_a, to_a), dot(to_b, to_b), dot(to_c, to_c)))
    return from_edge, from_corner / _find_least_height(triangle)


@compiled(error_model="numpy")
def _find_least_cosine(vertices, faces, origin, scale, around, face, normal):
    """Return the least cosine between a face's normal and those of the faces around its corners."""
    least = 1.0
    for corner in range(3):
        point = around.points[faces[face, corner]]
        for slot in range(around.begins[point], around.begins[point + 1]):
            other = around.faces[slot]
            a = _to_local(vertices, faces[other, 0], origin, scale)
            b = _to_local(vertices, faces[other, 1], origin, scale)
            c = _to_local(vertices, faces[other, 2], origin, scale)
            least = min(least, _find_cosine(a, b, c, normal))
    return least


@compiled(error_model="numpy")
def _find_cosine(a, b, c, normal):
    """Return the cosine between the normal of a triangle and another one; NaN without an area."""
    upright = cross(subtract(b, a), subtract(c, a))
    return dot(normal, upright) / np.sqrt(dot(upright, upright))


@compiled
def _find_walls(vertices, faces, origin, scale, around, face, normal):
    """Return the corners of the triangles around the corners of a face, (n, 3, 3): first the corner that they share.

    Those that share two are there twice, or not at all if they are not steep.
    """
    count, points = 0, around.points
    for corner in range(3):
        point = points[faces[face, corner]]
        count += around.begins[point + 1] - around.begins[point] - 1
    walls, wall = np.empty((count, 3, 3)), 0
    for corner in range(3):
        point = points[faces[face, corner]]
        for slot in range(around.begins[point], around.begins[point + 1]):
            other = around.faces[slot]
            if other != face:
                first = 0
                for own in range(3):
                    first = own if points[faces[other, own]] == point else first
                shared = 0
                for own in range(3):
                    x, y, z = _to_local(vertices, faces[other, (first + own) % 3], origin, scale)
                    walls[wall, own, 0], walls[wall, own, 1], walls[wall, own, 2] = x, y, z
                    own_point = points[faces[other, own]]
                    for of_face in range(3):
                        shared += points[faces[face, of_face]] == own_point
                one, two, three = _corner(walls, wall, 0), _corner(walls, wall, 1), _corner(walls, wall, 2)
                if shared < 2 or not _find_cosine(one, two, three, normal) >= _LEAST_COSINE:
                    wall += 1
    return walls[:wall]


@compiled
def _corner(walls, wall, corner):
    return walls[wall, corner, 0], walls[wall, corner, 1], walls[wall, corner, 2]


@compiled(error_model="numpy")
def _find_margins(triangle, normal, walls):
    """Return how close to an edge, and to a corner, of a triangle a ball of radius 1 may not fit.

    In least heights of the triangle: no point whose weights are all larger than the first one is so close to an edge.
    A wall and the triangle are two cones from a common corner. With a direction d of the one and e of the other, of
    length 1, the ball that touches the triangle at ``r e`` reaches the wall where ``r < d.normal / (1 - d.e)``.
    """
    of_edges = of_corners = 0.0
    for wall in range(len(walls)):
        apex = _corner(walls, wall, 0)
        corner = 0 if apex == triangle[0] else 1 if apex == triangle[1] else 2
        one, two = _corner(walls, wall, 1), _corner(walls, wall, 2)
        d, other_d = subtract(one, apex), subtract(two, apex)
        if not max(dot(d, normal), dot(other_d, normal)) > 0.0:
            continue
        d, other_d = _unit(d), _unit(other_d)
        rise = max(dot(d, normal), dot(other_d, normal))
        if not rise > _LEAST_RISE:
            continue
        left, right = triangle[(corner + 1) % 3], triangle[(corner + 2) % 3]
        e, other_e = _unit(subtract(left, apex)), _unit(subtract(right, apex))
        if left in (one, two) or right in (one, two):
            # At a common edge, the directions that matter are those at right angles to it.
            if one in (left, right):
                d = other_d
            if right in (one, two):
                e, other_e = other_e, e
            d, other_e = _across(d, e), _across(other_e, e)
            of_edges = max(of_edges, _find_room(dot(d, normal), dot(d, other_e)))
        else:
            cosine = max(_cosine(e, d, other_d), _cosine(other_e, d, other_d))
            cosine = max(_cosine(d, e, other_e), _cosine(other_d, e, other_e), cosine)
            # Directions between two may rise more than both.
            rise /= np.sqrt(max(0.5 + 0.5 * dot(d, other_d), 0.0))
            of_corners = max(of_corners, _find_room(min(rise, 1.0), cosine))
    unit = _find_least_height(triangle)
    # Written so that NaN has no walls.
    return of_edges / unit if of_edges > 0.0 else _NO_WALLS, of_corners / unit if of_corners > 0.0 else _NO_WALLS


@compiled(error_model="numpy")
def _find_room(rise, cosine):
    return min(rise / (1.0 - cosine), _MOST_ROOM) if cosine < 1.0 else _MOST_ROOM


@compiled(error_model="numpy")
def _unit(vector):
    length = np.sqrt(dot(vector, vector))
    return vector[0] / length, vector[1] / length, vector[2] / length


@compiled
def _across(direction, edge):
    return _unit(add_scaled(direction, -dot(direction, edge), edge))


@compiled
def _cosine(direction, left, right):
    """Return the cosine of the least angle between a direction and those from one to another one."""
    normal = _unit(cross(left, right))
    if dot(cross(left, direction), normal) >= 0.0 and dot(cross(direction, right), normal) >= 0.0:
        height = dot(direction, normal)
        return np.sqrt(max(1.0 - height * height, 0.0))
    return max(dot(direction, left), dot(direction, right))


@compiled(error_model="numpy")
def _find_place(triangle, normal, walls, radius, u, v):
    """Return the coordinates of the nearest point of a triangle at which a ball fits; those given if there is none.

    The point is moved at right angles away from each edge, and to the centroid, by longer and longer steps.
    """
    a, b, c = triangle
    place = add_scaled(add_scaled(a, u, subtract(b, a)), v, subtract(c, a))
    if _fits(walls, add_scaled(place, radius, normal), radius):
        return u, v
    upright = cross(subtract(b, a), subtract(c, a))
    doubled_area, upright = np.sqrt(dot(upright, upright)), _unit(upright)
    away_of_a, away_of_b = cross(upright, subtract(c, b)), cross(upright, subtract(a, c))
    away_of_c = cross(upright, subtract(b, a))
    centroid = add_scaled(add_scaled(a, 1.0 / 3.0, subtract(b, a)), 1.0 / 3.0, subtract(c, a))
    step = radius
    while step <= _MOST_MOVE:
        for toward in (away_of_a, away_of_b, away_of_c, subtract(centroid, place)):
            way = _unit(toward)
            moved_u = u + step * dot(away_of_b, way) / doubled_area
            moved_v = v + step * dot(away_of_c, way) / doubled_area
            if min(moved_u, moved_v, 1.0 - moved_u - moved_v) > 0.0:
                centre = add_scaled(add_scaled(place, step, way), radius, normal)
                if _fits(walls, centre, radius):
                    return moved_u, moved_v
        step *= _STEP_GROWTH
    return u, v


@compiled
def _fits(walls, centre, radius):
    """Return whether no wall reaches into a ball."""
    limit = (radius * (1.0 - _SLACK)) ** 2
    for wall in range(len(walls)):
        corners = _corner(walls, wall, 0), _corner(walls, wall, 1), _corner(walls, wall, 2)
        if measure_triangles((centre, centre, centre), corners, limit)[0] < limit:
            return False
    return True
