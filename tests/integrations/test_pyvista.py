"""Meshes of pyvista, and its rays: objects with its attributes. It is there itself in tests/peers."""

import copy
import sys
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import MeshError
from clbvh.geometry.as_mesh import as_mesh
from clbvh.integrations import pyvista as ours
from clbvh.integrations.trimesh import RayMeshIntersector

# Two unit squares and a triangle beside each other, in the plane z = 0.
POINTS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [3, 0, 0]]
POLYGONS = [[0, 1, 2, 3], [1, 4, 5, 2], [4, 6, 5]]
DOWN = [0.0, 0.0, -1.0]


class PolyData:
    """As much of a `pyvista.PolyData` as is read: cells of points come first, then polygons."""

    n_lines, lines, strips = 0, (), ()

    def __init__(self, points, polygons, n_verts=0):
        self.points, self.polygons, self.n_verts = np.array(points, np.float32), polygons, n_verts
        self.verts, self.cell_data = np.tile([1, 0], n_verts), {}

    faces = property(lambda self: np.array([each for polygon in self.polygons for each in (len(polygon), *polygon)]))
    is_all_triangles = property(lambda self: self.n_verts == 0 and all(len(each) == 3 for each in self.polygons))
    n_cells = property(lambda self: self.n_verts + len(self.polygons))

    def copy(self, deep):
        twin = copy.copy(self)
        twin.cell_data = dict(self.cell_data)
        return twin

    def triangulate(self):
        """Cut polygons around their last corners, as no reader of ours does, and drop the cells of points."""
        cut = [(number, [each[-1], *pair]) for number, each in enumerate(self.polygons) for pair in pairwise(each[:-1])]
        twin = PolyData(self.points, [polygon for _, polygon in cut])
        ids = [self.n_verts + number for number, _ in cut]
        twin.cell_data = {name: values[ids] for name, values in self.cell_data.items()}
        return twin


def test_polygons_grids_and_triangles_are_meshes():
    squares = PolyData(POINTS, POLYGONS, n_verts=2)
    faces = [[3, 0, 1], [3, 1, 2], [2, 1, 4], [2, 4, 5], [5, 4, 6]]
    grid = SimpleNamespace(points=None, cells=None, extract_surface=lambda: squares)
    for thing in (squares, grid, squares.triangulate()):
        mesh = as_mesh(thing)
        assert mesh.faces.tolist() == faces
        assert mesh.vertices.tolist() == POINTS
    stripped = PolyData(POINTS, POLYGONS[2:])
    stripped.strips, stripped.triangulate = [4, 0, 1, 3, 2], squares.triangulate
    assert as_mesh(stripped).face_count == 5
    with clbvh.Tracer(squares) as tracer:
        assert tracer.closest_hit([2.1, 0.1, 5], DOWN).prim_id == 4
    for wrong, message in (
        (PolyData(POINTS, [[0, 1, 9]]), "PolyData: face 0 refers to vertex 9"),
        (SimpleNamespace(extract_surface=lambda: 1 / 0), r"a types\.SimpleNamespace has no triangles that can be read"),
    ):
        with pytest.raises(MeshError, match=message):
            clbvh.Scene(wrong)


def test_cells_are_those_of_the_mesh_that_was_given():
    squares = PolyData(POINTS, POLYGONS, n_verts=2)
    places = [[0.9, 0.2, 5], [9, 9, 5], [1.2, 0.9, 5], [0.2, 0.9, 5], [2.2, 0.2, 5], [np.nan, 0, 5]]
    points, rays, cells = ours.multi_ray_trace(squares, places, [DOWN] * 6)
    assert (rays.tolist(), cells.tolist()) == ([0, 2, 3, 4], [2, 3, 2, 4])
    assert points == pytest.approx(np.array(places)[rays] * [1, 1, 0])
    with clbvh.Tracer(squares) as tracer:
        hits = tracer.closest_hit(np.array(places)[rays], DOWN)
    assert ours.find_cell_ids(squares)[hits.prim_id].tolist() == cells.tolist()
    assert squares.cell_data == {}
    with pytest.raises(MeshError, match=r"expected a pyvista\.PolyData, not a Mesh"):
        ours.multi_ray_trace(clbvh.make_shape("icosphere", triangles=80), places, [DOWN] * 6)


@pytest.mark.parametrize("seed", [3])
def test_points_orders_and_dtypes_are_those_of_trimesh(seed):
    rng = np.random.default_rng(seed)
    ball = trimesh.creation.torus(1, 0.4)
    mesh = PolyData(ball.vertices, ball.faces.tolist())
    origins, directions = rng.normal(size=(500, 3)), rng.normal(size=(500, 3))
    engine = RayMeshIntersector((mesh.points, ball.faces))
    for first_point in (True, False):
        points, rays, cells = ours.multi_ray_trace(mesh, origins, directions, first_point)
        expected = engine.intersects_location(origins, directions, not first_point)
        np.testing.assert_equal((points, rays, cells), expected)
        assert rays.dtype == cells.dtype == np.int64
    assert len(rays) > len(set(rays)) > 50
    by_ray = ours.multi_ray_trace(mesh, origins, directions, retry=True)
    assert by_ray[0].tolist() == points[np.argsort(rays, kind="stable")].tolist()
    # Nothing is kept of a mesh that has changed, and nothing is lost after 100 hits.
    mesh.points += 100
    assert len(ours.multi_ray_trace(mesh, origins, directions)[1]) == 0
    layers = np.arange(150).repeat(3)[:, None] * DOWN + np.tile(POINTS[:3], (150, 1))
    pile = PolyData(layers, np.arange(450).reshape(-1, 3))
    assert ours.multi_ray_trace(pile, [[0.9, 0.2, 5]], [DOWN])[2].tolist() == list(range(150))


def test_a_segment_hits_cells_in_their_order_up_to_its_end():
    corners = [[x, y, z] for z in (3, 1, 1, 2) for x, y, _ in POINTS[:4]]
    floors = PolyData(corners, np.arange(16).reshape(4, 4).tolist(), n_verts=2)
    segments = (0, 9, [3, 5, 2]), (9, 2, [2, 5]), (2, 1, [5, 3]), (5, 9, []), (1, 1, []), (0, np.nan, [])
    for begin, end, cells in segments:
        found = ours.ray_trace(floors, [0.25, 0.5, begin], [0.25, 0.5, end])
        assert (found[0].dtype, found[1].dtype, found[0].shape) == (np.float32, np.int64, (len(cells), 3))
        assert (found[1].tolist(), found[0][:, 2].tolist()) == (cells, [{2: 3, 3: 1, 5: 2}[cell] for cell in cells])
    point, cells = ours.ray_trace(floors, [0.25, 0.5, 0], [0.25, 0.5, 9], first_point=True)
    assert (point.tolist(), cells.tolist()) == ([0.25, 0.5, 1], [3, 5, 2])
    with pytest.raises(clbvh.QueryError, match=r"end_point must be \(n,3\), not of shape \(1, 2\)"):
        ours.ray_trace(floors, [0, 0, 0], [0, 1])


def test_methods_of_every_mesh_are_replaced_and_restored(monkeypatch):
    for name in ("ray_trace", "multi_ray_trace"):
        monkeypatch.setattr(PolyData, name, lambda *_, **given: given or "pyvista's own", raising=False)
    kind = type("Mesh", (PolyData,), {})
    monkeypatch.setitem(sys.modules, "pyvista", SimpleNamespace(PolyData=kind))
    mesh = kind(POINTS, POLYGONS)
    ours.install()
    ours.install()
    assert mesh.multi_ray_trace([[0.9, 0.2, 5]], [DOWN], first_point=True)[2].tolist() == [0]
    assert mesh.ray_trace([0.9, 0.2, 5], [0.9, 0.2, -5])[1].tolist() == [0]
    plotted = mesh.ray_trace([0.9, 0.2, 5], [0.9, 0.2, -5], plot=True)
    assert plotted == {"first_point": False, "plot": True, "off_screen": None}
    for _ in range(2):
        ours.uninstall()
        assert mesh.ray_trace([], []) == mesh.multi_ray_trace([], []) == "pyvista's own"
