"""The oracle: every triangle against every ray, in float64, on the host.

It shares no code with the device: an orthonormal frame instead of a shear, double instead of single precision, no
tree. Slow on purpose; `--validate` and the tests compare with it.

A ray that passes an edge closer than float32 can resolve has no single right answer. So the oracle does not return
one hit: it says whether an answer is right, with triangles sorted into surely hit, surely missed, and too close to
call.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clbvh.geometry import Mesh
from clbvh.structs import NO_PRIM
from clbvh.support.compiled import compiled
from clbvh.trace.check.intersections import make_frame, meet_triangle, project
from clbvh.trace.hits.hits import AllHits, Hits

# How far the device's float32 may be off, in units of the rounding of the largest coordinate that the test sees,
# 2^-24 times the distance from the ray's origin. The watertight test rounds each coordinate about six times.
_ROUNDINGS = 16.0
_FLOAT32_ROUNDING = 2.0**-24


@dataclass(frozen=True)
class Difference:
    """A ray whose answer is wrong.

    Attributes
    ----------
    ray : int
    obtained_t, obtained_prim_id : float, int
        The answer of the traversal.
    expected_t, expected_prim_id : float, int
        The nearest triangle that the ray surely hits; infinite and -1 if there is none.
    """

    ray: int
    obtained_t: float
    obtained_prim_id: int
    expected_t: float
    expected_prim_id: int

    def __str__(self) -> str:
        return (
            f"ray {self.ray}: obtained t = {self.obtained_t:.9g} on triangle {self.obtained_prim_id}, "
            f"expected t = {self.expected_t:.9g} on triangle {self.expected_prim_id}"
        )


def find_differences(
    mesh: Mesh, origins: NDArray[np.float64], directions: NDArray[np.float64], hits: Hits
) -> list[Difference]:
    """Return the rays whose closest hit cannot be right.

    Parameters
    ----------
    mesh : Mesh
    origins, directions : (n, 3) float64, the file's coordinates
    hits : Hits
        The answers of a traversal, n of them.

    Returns
    -------
    list of Difference
        A hit is right when its triangle is hit, or too close to call, at that distance, `u` and `v` name a point of
        the triangle on the ray, and no triangle is surely hit before it; a miss, when no triangle is surely hit and
        t is infinite.

    Notes
    -----
    O(rays x triangles).
    """
    nearest_sure = np.empty(len(origins), np.float64)
    sure_prim = np.empty(len(origins), np.int64)
    hit_is_possible = np.empty(len(origins), np.bool_)
    given = _Hits(
        np.asarray(hits.t, np.float64), np.asarray(hits.u, np.float64), np.asarray(hits.v, np.float64),
        np.asarray(hits.prim_id, np.int64),
    )  # fmt: skip
    _judge(_question(mesh, origins, directions), given, nearest_sure, sure_prim, hit_is_possible)
    wrong = ~hit_is_possible | (nearest_sure < np.inf) & ~hits.is_hit
    return [
        Difference(int(ray), float(hits.t[ray]), int(hits.prim_id[ray]), float(nearest_sure[ray]), int(sure_prim[ray]))
        for ray in np.flatnonzero(wrong)
    ]


def find_wrong_crossings(
    mesh: Mesh, origins: NDArray[np.float64], directions: NDArray[np.float64], hits: AllHits
) -> NDArray[np.int64]:
    """Return the rays whose crossings cannot be all that there are.

    Parameters
    ----------
    mesh : Mesh
    origins, directions : (n, 3) float64, the file's coordinates
    hits : AllHits
        The answers of a traversal for n rays, without limits.

    Returns
    -------
    (m,) int64
        Rays that surely miss a triangle they are said to cross, surely cross one they are not, or cross one twice.

    Notes
    -----
    O(rays x triangles).
    """
    is_wrong = np.zeros(len(origins), np.bool_)
    _judge_crossings(_question(mesh, origins, directions), hits.offsets, hits.prim_id, is_wrong)
    return np.flatnonzero(is_wrong)


class _Question(NamedTuple):
    """Triangles and rays in local coordinates, and the largest rounding of the device, relative to the largest one."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    degenerate: NDArray[np.bool_]
    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    rounding: float


class _Hits(NamedTuple):
    """The answers of a traversal, one for each ray."""

    t: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    prim_id: NDArray[np.int64]


def _question(mesh: Mesh, origins: NDArray[np.float64], directions: NDArray[np.float64]) -> _Question:
    return _Question(
        mesh.local_vertices.astype(np.float64), mesh.faces, mesh.degenerate_faces,
        np.ascontiguousarray(mesh.to_local(origins)), np.multiply(directions, mesh.scale, dtype=np.float64),
        _ROUNDINGS * _FLOAT32_ROUNDING,
    )  # fmt: skip


@compiled
def _judge_crossings(question, offsets, prim_ids, is_wrong):
    """Compare every ray's crossings with every triangle; see `find_wrong_crossings`."""
    vertices, faces, degenerate = question.vertices, question.faces, question.degenerate
    origins, directions, rounding = question.origins, question.directions, question.rounding
    frame = np.empty((3, 3), np.float64)
    found_by = np.full(len(faces), -1, np.int64)
    for ray in range(len(origins)):
        make_frame(directions[ray], frame)
        for crossing in range(offsets[ray], offsets[ray + 1]):
            is_wrong[ray] |= found_by[prim_ids[crossing]] == ray
            found_by[prim_ids[crossing]] = ray
        for prim in range(len(faces)):
            is_found = found_by[prim] == ray
            if degenerate[prim]:
                is_wrong[ray] |= is_found
                continue
            sureness, _, low, high = _meet(vertices, faces, prim, origins[ray], frame, rounding)
            surely_crossed = sureness > 0 and low > 0.0
            surely_missed = sureness < 0 or high < 0.0
            is_wrong[ray] |= (surely_crossed and not is_found) or (surely_missed and is_found)


@compiled
def _judge(question, hits, nearest_sure, sure_prim, possible):
    """Compare every ray's hit with every triangle; see `find_differences`."""
    vertices, faces, degenerate = question.vertices, question.faces, question.degenerate
    origins, directions, rounding = question.origins, question.directions, question.rounding
    hit_t, hit_u, hit_v, hit_prim = hits.t, hits.u, hits.v, hits.prim_id
    frame = np.empty((3, 3), np.float64)
    for ray in range(len(origins)):
        length = make_frame(directions[ray], frame)

        # The triangle found must be one that the ray can hit, near the distance found. Written so that NaN fails.
        found_at_least = np.inf
        prim = hit_prim[ray]
        if prim == NO_PRIM:
            possible[ray] = hit_t[ray] == np.inf
        elif prim < 0 or prim >= len(faces) or degenerate[prim]:
            possible[ray] = False
        else:
            sureness, _, found_at_least, high = _meet(vertices, faces, prim, origins[ray], frame, rounding)
            possible[ray] = (
                sureness >= 0
                and found_at_least <= hit_t[ray] * length <= high
                and _is_on_ray(vertices, faces, prim, origins[ray], frame, rounding, hit_u[ray], hit_v[ray])
            )

        # And no triangle may surely be hit before it.
        nearest_sure[ray], sure_prim[ray] = np.inf, -1
        for prim in range(len(faces)):
            if degenerate[prim]:
                continue
            sureness, distance, low, high = _meet(vertices, faces, prim, origins[ray], frame, rounding)
            if sureness > 0 and low > 0.0 and distance < nearest_sure[ray] * length:
                nearest_sure[ray], sure_prim[ray] = distance / length, prim
                if high < found_at_least:
                    possible[ray] = False


@compiled
def _meet(vertices, faces, prim, origin, frame, rounding):
    """Test one triangle against one ray; see `meet_triangle`."""
    # The corners as seen from the ray's origin, and what float32 can do to them.
    a = project(vertices, faces[prim, 0], origin, frame)
    b = project(vertices, faces[prim, 1], origin, frame)
    c = project(vertices, faces[prim, 2], origin, frame)
    reach = max(abs(a[0]), abs(a[1]), abs(a[2]), abs(b[0]), abs(b[1]), abs(b[2]), abs(c[0]), abs(c[1]), abs(c[2]))
    return meet_triangle(a, b, c, rounding * reach)


@compiled
def _is_on_ray(vertices, faces, prim, origin, frame, rounding, u, v):
    """Return whether u and v name a point of the triangle that is on the ray, as far as float32 can tell."""
    if not (u >= 0.0 and v >= 0.0 and u + v <= 1.0 + rounding):
        return False
    ax, ay, az = project(vertices, faces[prim, 0], origin, frame)
    bx, by, bz = project(vertices, faces[prim, 1], origin, frame)
    cx, cy, cz = project(vertices, faces[prim, 2], origin, frame)
    blur = rounding * max(abs(ax), abs(ay), abs(az), abs(bx), abs(by), abs(bz), abs(cx), abs(cy), abs(cz))

    # A blurred corner changes the area opposite it by the blur times an edge, and so the weight of another corner.
    double_area = abs((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
    reach_a, reach_b, reach_c = np.hypot(ax, ay), np.hypot(bx, by), np.hypot(cx, cy)
    longest = max(np.hypot(bx - ax, by - ay), np.hypot(cx - bx, cy - by), np.hypot(ax - cx, ay - cy))
    slack = blur * (double_area + longest * (reach_a + reach_b + reach_c))
    w = 1.0 - u - v
    return np.hypot(w * ax + u * bx + v * cx, w * ay + u * by + v * cy) * double_area <= slack
