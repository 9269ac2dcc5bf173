"""Polygons of any shape become triangles that cover them: the sum of areas that all face one side is the polygon's."""

import meshio
import numpy as np
import pytest

import clbvh
from clbvh.geometry.loading import polygons
from clbvh.geometry.loading.polygons import cut_fans, cut_polygons

L = [(0, 0), (4, 0), (4, 1), (1, 1), (1, 4), (0, 4)]
SQUARE, HOLE = [(0, 0), (4, 0), (4, 4), (0, 4)], [(1, 1), (1, 3), (3, 3), (3, 1)]
COMB = [(0, -1), (7, -1), *[(7 - x, y) for x in range(8) for y in ((3, 0) if x % 2 else (0, 3))]]
SPIRAL = [(0, 0), (5, 0), (5, 5), (1, 5), (1, 2), (3, 2), (3, 3), (2, 3), (2, 4), (4, 4), (4, 1), (0, 1)]
SHAPES = {  # with the area that each has by a formula
    "L": (L, 7),
    "arch": ([(0, 0), (1, 0), (1, 3), (3, 3), (3, 0), (4, 0), (4, 4), (0, 4)], 10),
    "comb": (COMB, 19),
    "spiral": (SPIRAL, 15),
    "a hole reached by an edge there and back": ([*SQUARE, (0, 0), *HOLE, (1, 1)], 12),
    "holes at two corners": (
        [*SQUARE[:3], (3, 3), (3, 2.5), (2.5, 3), (3, 3), *SQUARE[2:], (0, 0), (1, 1), (1, 2), (2, 1), (1, 1)],
        15.375,
    ),
    "holes at one corner": (
        [*SQUARE, (0, 0), (1, 2), (1, 3), (2, 2), (1, 2), (0, 0), (2, 1), (2, 1.5), (3, 1), (2, 1)],
        15.25,
    ),
    "a hole that touches a corner": ([*SQUARE, (0, 0), (1, 2), (2, 1)], 14.5),
    "a hole that touches an edge": ([(0, 0), (2, 0), (1, 1), (2, 2), (3, 1), (2, 0), (4, 0), (4, 4), (0, 4)], 14),
    "two squares at a corner": ([(0, 0), (1, 0), (1, 1), (2, 1), (2, 2), (1, 2), (1, 1), (0, 1)], 2),
    "doubled corners": ([corner for corner in L for _ in range(2)], 7),
    "a spike": ([(0, 0), (4, 0), (4, 1), (1, 1), (3, 1), (1, 1), (1, 4), (0, 4)], 7),
}
# Axes of a plane, its origin, and the unit.
FRAMES = [
    (np.eye(3)[:2], 0, 1.0),
    (np.eye(3)[[1, 0]], 0, 1.0),
    (np.eye(3)[[2, 0]], 0, 1.0),
    (np.array([[0.6, 0.48, 0.64], [0.8, -0.36, -0.48]]), [5, -7, 3], 1.0),
    (np.eye(3)[1:], 0, 1e-200),
    (np.eye(3)[1:], 0, 1e200),
]


def cut(*shapes):
    """Return the triangles' corners, (F, 3, 3), of polygons (n, 3), which have vertices of their own."""
    sizes = np.array([len(shape) for shape in shapes])
    ids = np.arange(sizes.sum())
    return cut_polygons(ids, sizes, ids, np.concatenate(shapes))


def find_areas(corners, normal):
    """Return the areas of triangles, (F, 3, 3), as seen from a direction: negative where they face away."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ normal / 2


@pytest.mark.parametrize("name", SHAPES)
def test_a_polygon_is_covered_once_whatever_its_first_corner_and_its_plane(name):
    corners, area = np.array(SHAPES[name][0], float), SHAPES[name][1]
    for axes, origin, unit in FRAMES:
        points, normal = corners @ axes + origin, np.cross(*axes)
        for first in range(len(points)):
            for step, side in ((1, normal), (-1, -normal)):
                shape = np.roll(points, first, axis=0)[::step]
                triangles = cut(shape * unit)
                assert triangles.shape == (len(shape) - 2, 3)
                areas = find_areas(shape[triangles], side)
                assert areas.min() > -1e-12, (first, step)
                assert areas.sum() == pytest.approx(area, rel=1e-12)


def make_star(corners, seed):
    """Return a polygon around the origin whose corners are at any distance from it."""
    generator = np.random.default_rng(seed)
    angles = 2 * np.pi * (np.arange(corners) + generator.uniform(0, 0.9, corners)) / corners
    radii = generator.uniform(0.05, 1, corners)
    return np.column_stack((radii * np.cos(angles), radii * np.sin(angles), np.zeros(corners)))


@pytest.mark.parametrize("pairs", [7, 1 << 20])
def test_many_polygons_of_any_size_are_cut_in_their_order(pairs, monkeypatch):
    monkeypatch.setattr(polygons, "_BLOCK_PAIRS", pairs)
    monkeypatch.setattr(polygons, "_BLOCK_CORNERS", 50)
    monkeypatch.setattr(polygons, "_BLOCK_QUADS", 1)
    shapes = [make_star(corners, corners) for corners in (5, 3, 100, 4, 12, 6, 1000, 3, 30)]
    shapes.insert(4, np.array([[0, 0, 0], [1, 0, 0.0]]))
    triangles = cut(*shapes)
    assert len(triangles) == sum(max(0, len(shape) - 2) for shape in shapes)
    points, begin, corner = np.concatenate(shapes), 0, 0
    for shape in shapes:
        own = triangles[begin : begin + max(0, len(shape) - 2)]
        begin, corner = begin + len(own), corner + len(shape)
        if len(shape) > 2:
            assert sorted(set(own.ravel())) == list(range(corner - len(shape), corner))
            areas = find_areas(points[own], [0, 0, 1])
            x, y, _ = shape.T
            assert areas.min() > 0
            assert areas.sum() == pytest.approx((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def test_polygons_that_fans_cover_are_fans_byte_for_byte():
    generator = np.random.default_rng(3)
    shapes = []
    for corners in (3, 4, 4, 4, 5, 8, 64):
        angles = np.sort(generator.uniform(0, 2 * np.pi, corners))
        shapes.append(
            np.column_stack((np.cos(angles), np.sin(angles), np.zeros(corners))) @ generator.normal(size=(3, 3))
        )
    bent = [(0, 0, 0), (1, 0, 0.3), (1, 1, 0), (0, 1, 0.3)]
    flat_corner = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 2, 0)]
    crossing = [(0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0)]  # of area 0: there is no side
    not_finite = [(0, 0, 0), (1, 0, 0), (np.nan, 0.1, 0), (0, 1, 0)]
    concave_at_first = [(1, 1, 0), (1, 4, 0), (0, 0, 0), (4, 1, 0)]
    others = (bent, flat_corner, crossing, not_finite, [(0, 0, 0)] * 5, concave_at_first)
    shapes += [np.array(shape, float) for shape in others]
    sizes = np.array([len(shape) for shape in shapes])
    assert cut(*shapes).tobytes() == cut_fans(np.arange(sizes.sum()), sizes).tobytes()
    # Of one that crosses itself no answer is right; there is one, though.
    assert cut(np.array([(0, 0, 0), (4, 0, 0), (1, 3, 0), (2, -1, 0), (3, 3, 0.0)])).shape == (3, 3)
    # A quad that is neither flat nor convex is cut along its other diagonal.
    arrow = np.array([(0, 0, 0), (2, 1, 0.1), (4, 0, 0), (2, 5, 0.2)])
    assert {frozenset(triangle) for triangle in cut(arrow).tolist()} == {frozenset({0, 1, 3}), frozenset({1, 2, 3})}


def test_rays_pass_the_gap_of_a_face_of_every_format(tmp_path):
    points = np.array([(x, y, 0) for x, y in L])
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in points)
    header = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 1\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
    order, uvs = np.arange(6), " ".join(f"{x / 4} {y / 4}" for x, y in L)
    files = {
        "a.off": f"OFF\n6 1 0\n{rows}6 {' '.join(map(str, order))}\n",
        "a.obj": "".join(f"v {row}\n" for row in rows.splitlines()) + f"f {' '.join(map(str, order + 1))}\n",
        "a.ply": f"{header}{rows}6 {' '.join(map(str, order))} 12 {uvs}\n",
    }
    meshes = [meshio.Mesh(points.astype(float), [("polygon", [order])])]
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        meshes.append(clbvh.load_mesh(tmp_path / name))
    # Texture coordinates follow their corners.
    assert (meshes[-1].appearance.uvs * 4 == meshes[-1].vertices[meshes[-1].faces][..., :2]).all()
    inside = [(0.5, 0.5), (3.5, 0.5), (0.5, 3.5), (0.9, 0.9)]
    for mesh in meshes:
        with clbvh.Tracer(mesh) as tracer:
            origins = [(*place, 1) for place in (*inside, (1.1, 1.1), (3, 2), (2, 3))]
            assert tracer.any_hit(origins, [[0, 0, -1]]).tolist() == [True] * 4 + [False] * 3
