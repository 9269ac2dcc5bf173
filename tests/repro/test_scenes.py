"""Scenes that were shadowed by themselves, moved in place of another one, or traversed with a stack too short."""

from dataclasses import replace
from itertools import chain
from unittest.mock import Mock

import numpy as np
import pytest

import clbvh
from clbvh.builders import build
from clbvh.layouts import device_arrays
from clbvh.rendering import look_tables
from clbvh.trace.world import changes, trees
from clbvh.tree_layouts import LAYOUTS

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


@pytest.mark.on_opencl
def test_a_tree_that_got_deeper_was_traversed_with_the_stack_of_the_shallow_one(session, monkeypatch):
    monkeypatch.setitem(LAYOUTS, "bvh2", replace(LAYOUTS["bvh2"], common_stack=1))
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


@pytest.fixture
def make_file(tmp_path):
    def make(parts):
        """Return an OBJ file of pairs of squares, whose materials are their own, and one that the first pair has."""
        lines = ["mtllib many.mtl"]
        for part in range(parts):
            lines += [f"o part {part}", *(f"v {x + 3 * part} {y} {x * y / 9}" for x in (0, 1, 2) for y in (0, 1))]
            for square in range(2):
                lines += [f"usemtl {(2 * part + 1 - square) % (2 * parts - 1)}"]
                lines += ["f " + " ".join(str(6 * part + 2 * square + corner) for corner in (1, 2, 4, 3))]
        materials = (f"newmtl {number}\nKd {number / 99} 0.5 0.2" for number in range(2 * parts))
        (tmp_path / "many.mtl").write_text("\n".join(materials))
        (tmp_path / "many.obj").write_text("\n".join(lines))
        return tmp_path / "many.obj"

    return make


def test_every_part_of_a_file_was_asked_for_all_its_materials(make_file):
    """2,000 materials and 20,000 parts took two minutes to be drawn, and 40 million lines to be saved."""

    def names(mesh):
        ids = np.zeros(mesh.face_count, int) if (given := mesh.appearance.material_ids) is None else given
        return [mesh.appearance.materials[number].name for number in ids]

    file, scene = make_file(6), clbvh.Scene()
    meshes = [instance.geometry.shape for instance in scene.add_parts(file)]
    assert [len(mesh.appearance.materials) for mesh in meshes] == [2] * 6
    assert [*chain.from_iterable(map(names, meshes))] == names(clbvh.load_mesh(file))
    camera = {"camera": clbvh.Camera((9, 1, 20), (9, 0.5, 0)), "width": 90, "height": 40, "shading": "lambert"}
    joined = clbvh.Scene()
    joined.place(joined.add(file))
    np.testing.assert_array_equal(clbvh.render(scene, **camera).rgb, clbvh.render(joined, **camera).rgb)


def test_every_part_took_calls_of_its_own_for_its_tree_its_upload_and_its_normals(session, make_file, monkeypatch):
    """Python's calls: 1 ms for each part, of 20,000 parts 29 s until the first hits."""
    watched = {
        (build, "build_sah"), (device_arrays, "make_device_arrays"), (type(session), "mapped"),
        (type(session), "write"), (look_tables, "smooth_normals_by_angle"), (look_tables, "_pack_all_normals"),
    }  # fmt: skip

    def count_calls(parts):
        scene, counts = clbvh.Scene(), []
        scene.add_parts(make_file(parts))
        with monkeypatch.context() as patch:
            for owner, name in watched:
                spy = Mock(side_effect=getattr(owner, name))
                patch.setattr(owner, name, lambda *given, _spy=spy, **named: _spy(*given, **named))
                counts.append((name, spy))
            clbvh.render(scene, **CAMERA)
            return {name: spy.call_count for name, spy in counts}

    few = count_calls(20)
    assert count_calls(40) == few
    assert sum(few.values()) < 40
