"""Objects of pyvista and Open3D, and files that trimesh reads with other packages: the real ones."""

import warnings

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.geometry.as_mesh import as_mesh
from clbvh.integrations.pyvista import install, multi_ray_trace, ray_trace, uninstall


def need(name):
    """Return a module, or skip."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip(name, reason=f"peers: {name} is not installed", exc_type=ImportError)


def test_meshes_grids_and_blocks_of_pyvista():
    pyvista = need("pyvista")
    ball, cube = pyvista.Sphere(), pyvista.Cube()
    grid = pyvista.ImageData(dimensions=(3, 3, 3))
    things = ball, cube, ball.strip(), grid, grid.cast_to_unstructured_grid(), pyvista.MultiBlock([ball, cube])
    assert [as_mesh(thing).face_count for thing in things] == [1680, 12, 1680, 48, 48, 1692]
    assert all(as_mesh(thing).is_watertight for thing in things)
    np.testing.assert_array_equal(as_mesh(ball).faces, ball.regular_faces)
    for empty in (pyvista.PolyData(), pyvista.PolyData([[0.0, 0, 0]]), pyvista.PointSet([[0.0, 0, 0]])):
        with pytest.raises(clbvh.MeshError):
            as_mesh(empty)


@pytest.mark.parametrize("seed", [11])
def test_rays_of_pyvista_and_embree(seed):
    pyvista, _ = need("pyvista"), need("embreex")
    rng = np.random.default_rng(seed)
    ball = pyvista.ParametricSuperToroid(n1=0.5).triangulate()
    origins = rng.normal(size=(3000, 3)) * 3
    directions = rng.uniform(-1, 1, (3000, 3)) - origins
    for first_point in (True, False):
        ours = multi_ray_trace(ball, origins, directions, first_point)
        theirs = ball.multi_ray_trace(origins, directions, first_point=first_point)
        hits, their_hits = (set(map(tuple, np.transpose(each[1:]).tolist())) for each in (ours, theirs))
        # Where a ray meets an edge, the triangles on its sides are both right.
        assert len(hits ^ their_hits) <= len(hits) / 1000
        assert [each.dtype for each in ours] == [each.dtype for each in theirs]
    theirs = ball.multi_ray_trace(origins, directions, retry=True)
    assert multi_ray_trace(ball, origins, directions, retry=True)[1].tolist() == theirs[1].tolist()


def test_cells_are_those_of_vtk():
    pyvista = need("pyvista")
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]]
    faces, lines, dots = [3, 0, 1, 3, 4, 1, 4, 5, 2, 3, 1, 2, 3], [3, 0, 1, 2], [1, 5]
    mesh = pyvista.PolyData(np.array(points, float), faces=faces, lines=lines, verts=dots)
    ends = np.array([[0.2, 0.2, 5], [1.3, 0.6, 5], [0.9, 0.9, 5]])
    expected = [int(mesh.ray_trace(end, end * [1, 1, -1])[1][0]) for end in ends]
    install()
    try:
        assert mesh.multi_ray_trace(ends, [[0, 0, -1]] * 3)[2].tolist() == expected == [2, 3, 4]
        assert [int(mesh.ray_trace(end, end * [1, 1, -1])[1][0]) for end in ends] == expected
    finally:
        uninstall()
    assert mesh.array_names == []


@pytest.mark.parametrize("first_point", [False, True])
def test_segments_are_those_of_pyvista(first_point):
    pyvista = need("pyvista")
    for mesh in (pyvista.Box(), pyvista.Dodecahedron(), pyvista.Sphere()):
        # Towards smaller x: those that run to larger x pyvista 0.49 returns the other way round.
        for end in ([0.19, 0.12, -5], [0.19, 0.12, 0], [-9, 9, 0]):
            segment = [0.2, 0.1, 5], end
            found, expected = ray_trace(mesh, *segment, first_point), mesh.ray_trace(*segment, first_point=first_point)
            np.testing.assert_allclose(found[0], expected[0], rtol=0, atol=1e-6)
            assert found[1].tolist() == expected[1].tolist()
            assert [each.dtype for each in found] == [each.dtype for each in expected]


def test_meshes_of_open3d():
    open3d = need("open3d")
    box = open3d.geometry.TriangleMesh.create_box()
    box.paint_uniform_color([1, 0.5, 0])
    tensors = open3d.t.geometry.TriangleMesh.from_legacy(box)
    for thing in (box, tensors):
        mesh = as_mesh(thing)
        np.testing.assert_array_equal(mesh.faces, np.asarray(box.triangles))
        assert (mesh.appearance.colours == [255, 128, 0, 255]).all()
    with pytest.raises(clbvh.MeshError, match=r"an open3d\.TriangleMesh has no triangles that can be read"):
        as_mesh(open3d.t.geometry.TriangleMesh())


@pytest.mark.parametrize(("kind", "package"), [("3mf", "lxml"), ("dae", "collada")])
def test_files_that_trimesh_reads(tmp_path, kind, package):
    _ = need(package), need("networkx")
    cart = trimesh.Scene()
    for x in (0, 5):
        cart.add_geometry(trimesh.creation.box(), transform=clbvh.Transform(translate=(x, 0, 0)).matrix)
    path = tmp_path / f"cart.{kind}"
    path.write_bytes(data := (cart if kind == "3mf" else cart.to_mesh()).export(file_type=kind))
    mesh = clbvh.load_mesh(path)
    assert (mesh.face_count, mesh.vertices.max(), len(mesh.parts)) == (24, 5.5, 2 if kind == "3mf" else 0)
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(clbvh.MeshError, match=f"cart.{kind}: the {kind.upper()} file is damaged or incomplete"):
        clbvh.load_mesh(path)
