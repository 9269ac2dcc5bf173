"""Meshes whose arrays are on a device: as if the host had them, and nothing crosses the bus before somebody reads."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pyopencl as cl
import pyopencl.array
import pytest

from clbvh import Mesh, MeshError, Scene, Tracer, build, make_shape

from ...rays import hard_rays

pytestmark = pytest.mark.on_opencl


@pytest.fixture
def queue(session):
    """A queue in a context of the user's own."""
    return cl.CommandQueue(cl.Context([session.info.cl_device]))


def put(queue, *arrays):
    return [cl.array.to_device(queue, np.ascontiguousarray(array)) for array in arrays]


def bytes_of(bvh):
    mesh = bvh.mesh
    arrays = bvh.nodes, bvh.prim_ids, mesh.vertices, mesh.faces, mesh.local_vertices, mesh.origin, mesh.local_box
    return [array.tobytes() for array in arrays] + [mesh.scale, mesh.prim_count]


@pytest.mark.parametrize(("vertices_as", "faces_as"), [("f8", "i4"), ("f4", "u4")])
def test_trees_and_meshes_have_the_bytes_of_the_hosts(queue, vertices_as, faces_as):
    for mesh, unit, shift in (
        (make_shape("blobs", triangles=3000), 1, 0),
        (make_shape("knot", triangles=2000), 1e-20, 1e-19),
        (make_shape("terrain", triangles=500), [1, 1e3, 0], 4e5),
    ):
        vertices = (mesh.vertices * unit + shift).astype(vertices_as)
        expected = build((vertices, mesh.faces), quality="fast")
        assert bytes_of(build(put(queue, vertices, mesh.faces.astype(faces_as)), quality="fast")) == bytes_of(expected)


def test_nothing_crosses_the_bus_before_hits_are_refined(queue, traffic, mesh):
    mesh = make_shape("blobs", triangles=20_000)
    rays = hard_rays(mesh, 5000, np.random.default_rng(1))
    vertices, faces = put(queue, mesh.vertices, mesh.faces)
    with Tracer((vertices, faces), quality="fast") as tracer, Tracer(mesh, quality="fast") as other:
        traffic.clear()
        with Tracer((vertices, faces), quality="fast"):
            assert sum(traffic) < 60_000 < mesh.vertices.nbytes / 3
        assert (tracer.any_hit(*rays) == other.any_hit(*rays)).all()
        for step in range(3):
            moved = mesh.vertices * [1, 1 + step / 10, 1]
            (array,) = put(cl.CommandQueue(tracer.context), moved)
            traffic.clear()
            tracer.update(array)
            # The first time, the links of the tree are read.
            assert step == 0 or sum(traffic) < 60_000
            other.update(moved)
            # The tracer has its own copy.
            array.fill(0.0)
            assert "vertices" not in vars(tracer.mesh)
            hits, expected = tracer.closest_hit(*rays), other.closest_hit(*rays)
            assert hits.t.tobytes() == expected.t.tobytes()
            assert hits.locations.tobytes() == expected.locations.tobytes()
        assert bytes_of(tracer.bvh) == bytes_of(other.bvh)
    assert hits.locations.tobytes() == expected.locations.tobytes()


def test_a_mesh_of_the_host_moves_by_arrays_of_the_device_and_the_other_way_round(mesh):
    rays = hard_rays(mesh, 500, np.random.default_rng(2))
    scene = Scene(mesh)
    scene.place(scene.geometries[0], [[1, 0, 0, 9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    with Tracer(mesh) as tracer, Tracer(mesh) as other, Tracer(scene) as moving, Tracer(scene) as still:
        for step in range(4):
            moved = mesh.vertices * (1 + step / 9)
            for one, two, change in (
                (tracer, other, lambda each, array: each.update(array)),
                (moving, still, lambda each, array: each.set_vertices(scene.geometries[0], array)),
            ):
                (array,) = put(cl.CommandQueue(one.context), moved)
                change(one, moved if step == 2 else array)
                change(two, moved)
                assert one.closest_hit(*rays).t.tobytes() == two.closest_hit(*rays).t.tobytes()


def test_arrays_go_by_way_of_the_host_where_they_must(queue, session, mesh):
    vertices, faces = put(queue, mesh.vertices, mesh.faces)
    expected = build(mesh, quality="fast").nodes.tobytes()
    for source in (
        (vertices, mesh.faces),
        (vertices, *put(queue, mesh.faces.astype("i8"))),
        (*put(queue, np.asfortranarray(mesh.vertices)), faces),
        (*put(cl.CommandQueue(cl.Context([session.info.cl_device])), mesh.vertices), faces),
    ):
        assert build(source, quality="fast").nodes.tobytes() == expected
    assert build((vertices, faces), quality="fast", device=session.info).nodes.tobytes() == expected
    with Tracer((vertices, faces)) as tracer:  # of default quality
        assert tracer.mesh.vertices.tobytes() == mesh.vertices.tobytes()
    tree = build((vertices, faces), quality="fast")
    for again in (copy.copy(tree.mesh), pickle.loads(pickle.dumps(tree.mesh))):
        assert again.vertices.tobytes() == mesh.vertices.tobytes()
        assert build(again, quality="fast").nodes.tobytes() == expected


def test_wrong_arrays_are_refused_in_the_hosts_words(queue, mesh):
    vertices, faces = put(queue, mesh.vertices, mesh.faces)
    last = len(mesh.vertices) - 1
    nan, infinite = mesh.vertices.copy(), mesh.vertices.copy()
    nan[last, 2], infinite[0, 0] = np.nan, -np.inf
    for source, words in (
        ((vertices, *put(queue, mesh.faces + 1)), f"refers to vertex {last + 1}, but there are {last + 1} vertices"),
        ((vertices, *put(queue, mesh.faces - 1)), "refers to vertex -1"),
        ((*put(queue, nan), faces), f"vertex {last} has a coordinate that is not finite: z = nan"),
        ((*put(queue, infinite), faces), "vertex 0 has a coordinate that is not finite: x = -inf"),
        ((*put(queue, mesh.vertices * 1e160), faces), "units wide"),
        ((*put(queue, mesh.vertices[:, :2]), faces), r"shape \(V, 3\)"),
    ):
        with pytest.raises(MeshError, match=words):
            build(source, quality="fast")
    with Tracer((vertices, faces), quality="fast") as tracer:
        for array in put(cl.CommandQueue(tracer.context), nan, mesh.vertices[1:]):
            with pytest.raises(MeshError):
                tracer.update(array)
        assert isinstance(tracer.mesh, Mesh)
        assert tracer.mesh.vertices.tobytes() == mesh.vertices.tobytes()
