"""Scenes that were shadowed by themselves, moved in place of another one, or traversed with a stack too short."""

import numpy as np
import pytest

import clbvh
from clbvh.trace.world import changes, trees

CAMERA = {"camera": clbvh.Camera((0, 0, 9), (0, 0, 0)), "width": 9, "height": 9}


@pytest.mark.parametrize("copies", [1, 2])
@pytest.mark.parametrize("angle", [0, 180])
def test_a_flat_mesh_was_in_its_own_shadow(copies, angle):
    """Rays leave a surface at a distance that comes from the rounding of their position: none across such a plane."""
    scene = clbvh.Scene()
    flat = scene.add(clbvh.Mesh.from_arrays([[-1, -1, 0], [1, -1, 0], [0, 2, 0]], [[0, 1, 2]]))
    for number in range(copies):
        scene.place(flat, clbvh.Transform(rotate=(0, angle, 0), translate=(9.0 * number, 0, 0)))
    with clbvh.Renderer(scene, clbvh.View(ground=False, light=clbvh.Light((0, 0, 1)))) as renderer:
        plain, shadowed, occluded = (
            renderer.render(shading=name, **CAMERA).rgb for name in ("lambert", "lambert+shadow", "ao")
        )
    np.testing.assert_array_equal(shadowed, plain)
    # Sample 0 alone is not enough: no ray of any sample meets the triangle.
    assert occluded[4, 4].min() > 200


def test_layers_of_clear_panes_were_not_passed():
    panes = np.array([[[-1, -1, z], [1, -1, z], [0, 2, z]] for z in (-1, 0, 1)], float)
    appearance = clbvh.Appearance(materials=(clbvh.Material(alpha=0.0),))
    mesh = clbvh.Mesh.from_arrays(panes.reshape(-1, 3), np.arange(9).reshape(3, 3), appearance=appearance)
    assert not clbvh.render(mesh, ground=False, transparent=True, samples=2, **CAMERA).alpha.any()


def test_a_mesh_that_nothing_places_took_the_place_of_the_only_one_that_is_when_it_moved():
    scene, ball = clbvh.Scene(), clbvh.make_shape("icosphere", triangles=320)
    placed, other = scene.add(ball), scene.add(ball)
    scene.place(placed)
    with clbvh.Tracer(scene) as tracer:
        tracer.set_vertices(other, 2 * ball.vertices)
        assert tracer.closest_hit([[0, 0, 5]], [[0, 0, -1]]).t.tolist() == [4.0]
        tracer.set_vertices(placed, 3 * ball.vertices)
        assert tracer.closest_hit([[0, 0, 5]], [[0, 0, -1]]).t.tolist() == [2.0]


def test_a_tree_that_got_deeper_was_traversed_with_the_stack_of_the_shallow_one(session, monkeypatch):
    monkeypatch.setitem(trees._COMMON_STACK, "bvh2", 1)
    monkeypatch.setattr(trees, "_STACK_STEP", 1)
    count = 100
    corners, aside = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.2]]), np.array([2, -0.3, 0.1])
    chain = ((corners + aside) * 2.0 ** -np.arange(count)[:, None, None]).reshape(-1, 3)
    flat = np.tile(corners, (count, 1, 1)).reshape(-1, 3) + 2.0 * np.repeat(np.arange(count), 3)[:, None]
    scene = clbvh.Scene()
    mesh = scene.add((flat, np.arange(3 * count).reshape(-1, 3)))
    scene.place_many(mesh, [np.eye(4), clbvh.Transform(translate=(0, 0, 9)).matrix])
    with clbvh.Tracer(scene, device=session.info, layout="bvh2") as tracer:
        tracer.closest_hit([[0, 0, 5]], [[0, 0, -1]])
        before, kernel = tracer._caster.world.defines["STACK_SIZE"], tracer._caster.kernel("closest_hit")
        tracer.set_vertices(mesh, chain)
        assert tracer._caster.world.defines["STACK_SIZE"] > before
        assert tracer._caster.kernel("closest_hit") is not kernel


def test_a_build_of_another_geometry_let_the_wear_of_a_geometry_begin_anew(session, monkeypatch):
    scene = clbvh.Scene()
    meshes = [scene.add(clbvh.make_shape("knot", triangles=triangles)) for triangles in (2000, 3000)]
    for mesh in meshes:
        scene.place(mesh)
    x, y, z = meshes[0].shape.vertices.T
    bent = np.stack((x, np.cos(x) * y - np.sin(x) * z, np.sin(x) * y + np.cos(x) * z), axis=1)
    with clbvh.Tracer(scene, device=session.info) as tracer:
        growths = []
        for mesh, vertices, limit in (
            (meshes[0], bent, np.inf), (meshes[1], meshes[1].shape.vertices, 0.0), (meshes[0], bent, np.inf),
        ):  # fmt: skip
            monkeypatch.setattr(changes, "REBUILD_GROWTH", limit)
            tracer.set_vertices(mesh, vertices)
            growths.append(tracer._changes.sah_growth(0))
        assert growths[2] == growths[0] > 1.05
