"""What is nearest to a point, by slower ways: every triangle in float64, and the device without a tree."""

import numpy as np
import trimesh

from clbvh import build
from clbvh.structs import LAYOUT_WIDTHS
from clbvh.trace.launch import Caster
from clbvh.trace.points.queries import SeenPoints, find_closest_points
from clbvh.trace.rays.batch import read_points

from ...worlds import open_mesh

# The device chooses the triangle in float32, after about sixteen roundings.
CHOICE = 16 * 2.0**-24


def expected_distance(mesh, points):
    """The smallest distance to any triangle in float64, by trimesh's formula."""
    return distance_to_triangles(mesh.vertices[mesh.faces[~mesh.degenerate_faces]], points)


def distance_to_triangles(corners, points):
    """The smallest distance to any triangle of (n, 3, 3) float64, by trimesh's formula."""
    best = np.full(len(points), np.inf)
    for triangle in corners:
        nearest = trimesh.triangles.closest_point(np.broadcast_to(triangle, (len(points), 3, 3)), points)
        best = np.minimum(best, np.linalg.norm(nearest - points, axis=1))
    return best


def check_tree_and_brute_agree(session, mesh, points, **options):
    """Compare the bytes of what is found with a tree, in any layout, and without; return the faces."""
    bvh = build(mesh, **options)
    worlds = [open_mesh(session, mesh), *(open_mesh(session, mesh, bvh, layout) for layout in LAYOUT_WIDTHS)]
    casters = [Caster(session, world) for world in worlds]
    try:
        expected, *found = (
            find_closest_points(caster, SeenPoints(read_points(points), None, None)) for caster in casters
        )
    finally:
        for caster in casters:
            caster.release()
    for of_layout in found:
        for obtained, brute in zip(of_layout, expected, strict=True):
            assert obtained.tobytes() == brute.tobytes()
    return expected.prim_id
