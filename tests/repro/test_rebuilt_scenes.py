"""Geometries of a scene that are built anew: their kernels, and the wear of the others."""

import numpy as np

import clbvh
from clbvh.trace.world import changes, trees


def test_a_deeper_tree_gets_a_kernel_with_a_longer_stack(session, monkeypatch):
    """A caster kept the kernels by name only, so that a deep tree was traversed with the stack of a shallow one."""
    monkeypatch.setitem(trees._COMMON_STACK, "bvh2", 1)
    monkeypatch.setattr(trees, "_STACK_STEP", 1)
    count = 100
    corners, aside = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.2]]), np.array([2, -0.3, 0.1])
    size = 2.0 ** -np.arange(count)
    chain = ((corners + aside) * size[:, None, None]).reshape(-1, 3)
    flat = np.tile(corners, (count, 1, 1)).reshape(-1, 3) + 2.0 * np.repeat(np.arange(count), 3)[:, None]
    scene = clbvh.Scene()
    mesh = scene.add((flat, np.arange(3 * count).reshape(-1, 3)))
    scene.place_many(mesh, [np.eye(4), clbvh.Transform(translate=(0, 0, 9)).matrix])
    with clbvh.Tracer(scene, device=session.info, layout="bvh2") as moved:
        moved.closest_hit([[0, 0, 5]], [[0, 0, -1]])
        before = moved._caster.world.defines["STACK_SIZE"]
        moved.set_vertices(mesh, chain)
        assert moved._caster.world.defines["STACK_SIZE"] > before
        again = clbvh.Scene()
        again.place_many(again.add((chain, mesh.shape.faces)), [np.eye(4), clbvh.Transform(translate=(0, 0, 9)).matrix])
        with clbvh.Tracer(again, device=session.info, layout="bvh2") as opened:
            assert moved._caster.kernel("closest_hit") is opened._caster.kernel("closest_hit")


def test_the_wear_of_a_geometry_counts_from_its_own_build(session, monkeypatch):
    """A build of another geometry let it begin anew, so that it was never built again, however worn it was."""
    scene = clbvh.Scene()
    meshes = [scene.add(clbvh.make_shape("knot", triangles=triangles)) for triangles in (2000, 3000)]
    for mesh in meshes:
        scene.place(mesh)
    x, y, z = meshes[0].shape.vertices.T
    bent = np.stack((x, np.cos(x) * y - np.sin(x) * z, np.sin(x) * y + np.cos(x) * z), axis=1)
    with clbvh.Tracer(scene, device=session.info) as tracer:
        monkeypatch.setattr(changes, "REBUILD_GROWTH", np.inf)
        tracer.set_vertices(meshes[0], bent)
        growth = tracer._changes._refits[0].sah_growth
        assert growth > 1.05
        monkeypatch.setattr(changes, "REBUILD_GROWTH", 0.0)
        tracer.set_vertices(meshes[1], meshes[1].shape.vertices)
        monkeypatch.setattr(changes, "REBUILD_GROWTH", np.inf)
        tracer.set_vertices(meshes[0], bent)
        assert tracer._changes._refits[0].sah_growth == growth
