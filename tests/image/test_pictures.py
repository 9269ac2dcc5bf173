"""Small pictures of a mesh and of a scene with several objects: hits first, then pixels."""

from __future__ import annotations

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import clbvh
from clbvh import Camera, ConfigError, Light, Mesh, Renderer, RenderOptions, Scene, Spheres, ValidationError
from clbvh.builders.build import BUILDERS
from clbvh.choices import REPORT_SHADINGS
from clbvh.rendering import built_scene, painters, picture as picture_module

VIEW = clbvh.View(width=96, height=64, up="y")
SIZE = {"width": 64, "height": 48}
KNOT = clbvh.make_shape("knot", triangles=4000, seed=1)
BALL = clbvh.make_shape("icosphere", triangles=1280)
SPHERE = Spheres([[0.1, 0.2, 0.3]], 1.0)
RED, GREEN, BLUE = (0.8, 0.1, 0.05), (0.2, 0.5, 0.15), (0.1, 0.2, 0.9)
COLOUR_STEPS = 1  # colours that float32 rounds to one side or the other


def affine(linear, translation=(0.0, 0.0, 0.0)):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, translation
    return matrix


def rotation(seed):
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


MATRICES = {
    "turned": rotation(1),
    "stretched": rotation(2) @ np.diag([2.0, 0.5, 1.0]),
    "mirrored": rotation(3) @ np.diag([1.0, -1.0, 1.0]),
    "sheared": rotation(4) @ [[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
}


def still_life():
    """A terrain with knots, one of them mirrored, and spheres above it."""
    generator = np.random.default_rng(11)
    scene = Scene()
    ground, knot = scene.add(clbvh.make_shape("terrain", triangles=2000, seed=7)), scene.add(KNOT)
    crowd = scene.add(Spheres(generator.normal(size=(40, 3)), generator.uniform(0.1, 0.5, 40), name="crowd"))
    scene.place(ground, affine(np.eye(3), (0, -3, 0)), colour=GREEN)
    scene.place(knot, affine(rotation(5), (-2, 0, 0)))
    scene.place(knot, affine(0.6 * MATRICES["mirrored"], (0, 0, 2.5)), colour=BLUE)
    scene.place(crowd, affine(0.5 * MATRICES["stretched"], (2, 0.5, 0)), colour=RED)
    return scene


@pytest.fixture(scope="module", params=["knot", "scene"])
def renderer(request):
    with Renderer(KNOT if request.param == "knot" else still_life(), VIEW) as opened:
        opened.kind = request.param
        yield opened


@pytest.fixture
def source(renderer):
    return renderer.mesh or renderer.scene


def same_picture(one, other):
    return (one.rgb == other.rgb).all() and (one.found == other.found).all() and one.camera == other.camera


@pytest.mark.parametrize("shading", REPORT_SHADINGS)
def test_each_shading_looks_as_it_did(renderer, shading, compare_with_reference):
    picture = renderer.render(shading=shading)
    compare_with_reference(f"{renderer.kind}-{shading.replace('+', '-')}", picture.rgb)


def test_hits_are_those_of_the_tracer(renderer, source, open_tracer, monkeypatch):
    picture = renderer.render(shading="normal")
    traced, hits = open_tracer(source).closest_hit(*picture.camera.rays(96, 64)), picture.hits
    assert set(np.unique(hits.instance_id)) == ({-1, 0} if renderer.kind == "knot" else {-1, 0, 1, 2, 3})
    same = (traced.instance_id == hits.instance_id) & (traced.prim_id == hits.prim_id)
    # The kernel makes its rays in float32: at an edge the neighbour may be hit.
    assert same.mean() > 0.995
    monkeypatch.setattr(picture_module, "_CHUNK_PIXELS", 96 * 7)
    by_rows = picture_module.refine_pixels(picture.scene.surface, picture.camera, picture.found)
    for name in ("t", "u", "v", "geometry_id", "is_front"):
        assert np.array_equal(getattr(traced, name)[same], getattr(hits, name)[same]), name
        assert np.array_equal(getattr(by_rows, name), getattr(hits, name)), name


def test_pixels_depend_neither_on_trees_nor_on_layouts_nor_on_bands(renderer, source, tmp_path, monkeypatch):
    expected = renderer.render(shading="lambert+shadow")
    options = [{"layout": layout} for layout in ("bvh2", "bvh4", "bvh8")]
    options += [{"builder": builder} for builder in (*BUILDERS, "brute")]
    options += 2 * [{"workers": 2, "cache": tmp_path, "build": clbvh.BuildOptions(task_threshold=500)}]
    for each in options:
        picture = clbvh.render(source, VIEW, RenderOptions(**each), shading="lambert+shadow")
        assert same_picture(picture, expected), each
    assert picture.tree_from_cache
    monkeypatch.setattr(painters, "BAND_PIXELS", 96 * 7)
    assert same_picture(clbvh.render(source, VIEW, shading="lambert+shadow"), expected)
    placed = sum(instance.geometry.shape.prim_count for instance in renderer.scene.instances)
    monkeypatch.setattr(built_scene, "BRUTE_LIMIT", placed - 1)
    with pytest.raises(ConfigError, match="brute"):
        clbvh.render(source, VIEW, RenderOptions(builder="brute"))


def test_every_pixel_of_a_small_picture_is_validated_and_a_wrong_one_found(source, monkeypatch):
    def render_wrongly(self, view, painter, times=None):
        colours, hits = render_rightly(self, view, painter, times)
        hits["prim_id"][20, 16] = 3
        return colours, hits

    options = RenderOptions(validate=True)
    for width, height in ((1, 1), (7, 3), (40, 30)):
        assert clbvh.render(source, VIEW, options, width=width, height=height).validated_pixels == width * height
    render_rightly = painters.FrameRenderer.render
    monkeypatch.setattr(painters.FrameRenderer, "render", render_wrongly)
    with pytest.raises(ValidationError, match=r"1 of 1200 pixels differ .* column 16, row 20"):
        clbvh.render(source, VIEW, options, width=40, height=30)


def test_the_report_adds_up_and_a_picture_can_be_copied(renderer):
    picture = renderer.render()
    report = picture.report()
    assert (report["rays"], report["hits"]) == (96 * 64, picture.hits.count)
    times = report["timings_ms"]
    assert sum(ms for name, ms in times.items() if name != "total") == pytest.approx(times["total"], rel=0.01)
    assert report["mrays_per_s"] == pytest.approx(report["samples"] * report["rays"] / times["kernel"] / 1e3)
    if renderer.kind == "scene":
        ground, knot = (geometry.shape.face_count for geometry in renderer.scene.geometries[:2])
        assert (report["mesh"], report["triangles"], report["spheres"]) == ("4 instances", ground + knot, 40)
        assert (report["geometries"], report["instances"]) == (3, 4)
        assert report["placed_primitives"] == ground + 2 * knot + 40
    for duplicate in (lambda thing: pickle.loads(pickle.dumps(thing)), copy.copy, copy.deepcopy):
        copied = duplicate(picture)
        assert (copied.rgb.tobytes(), copied.hits.t.tobytes()) == (picture.rgb.tobytes(), picture.hits.t.tobytes())
        assert copied.report() == report
    elsewhere = dataclasses.replace(picture.device, name="Imagined", cl_device=None)
    with pytest.raises(clbvh.DeviceError, match=r"the device 'Imagined' .* is not here"):
        clbvh.Tracer(BALL, device=elsewhere)


def test_degenerate_triangles_are_counted_and_never_hit():
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0)]
    mesh = Mesh.from_arrays(vertices, [(0, 1, 2), (0, 1, 3), (2, 2, 1), (0, 0, 0)])
    picture = clbvh.render(mesh, options=RenderOptions(validate=True), **SIZE)
    assert picture.report()["degenerate_triangles"] == 3
    assert set(np.unique(picture.hits.prim_id)) == {-1, 0}


@pytest.mark.parametrize("kind", MATRICES)
def test_an_instance_looks_as_the_mesh_that_is_moved(kind):
    matrix = affine(MATRICES[kind], (1, 2, 3))
    scene = Scene()
    scene.place(scene.add(KNOT), matrix)
    moved = Mesh.from_arrays(KNOT.vertices @ matrix[:3, :3].T + matrix[:3, 3], KNOT.faces)
    with Renderer(scene, VIEW) as first, Renderer(moved, VIEW) as second:
        assert first.mesh is None
        for shading in REPORT_SHADINGS:
            one, other = first.render(shading=shading), second.render(shading=shading)
            # The cameras differ by the rounding of vertices to float32.
            np.testing.assert_allclose(one.camera.eye, other.camera.eye, rtol=0, atol=1e-5)
            assert (one.hits.prim_id == other.hits.prim_id).mean() > 0.995
            assert (np.abs(one.rgb.astype(int) - other.rgb).max(axis=2) > COLOUR_STEPS).mean() < 0.005


def test_colours_are_those_of_the_instances_that_rays_see():
    scene = Scene()
    ball = scene.add(BALL)
    for number, colour in enumerate([RED, None, BLUE]):
        scene.place(ball, affine(np.eye(3), (3 * number, 0, 0)), colour=colour)
    scene.place(ball, affine(np.eye(3), (-3, 0, 0)), mask=0)
    even = Light(colour=(0, 0, 0), sky=(1, 1, 1), ground=(1, 1, 1))
    with Renderer(scene, shading="lambert", light=even, width=60, height=30) as renderer:
        for surface in [(0.5, 0.5, 0.5), (0.0, 1.0, 0.0)]:
            picture = renderer.render(surface=surface)
            assert set(np.unique(picture.hits.instance_id)) == {-1, 0, 1, 2}
            for instance, colour in enumerate([RED, surface, BLUE]):
                linear = np.array(colour)
                expected = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
                pixels = picture.rgb[picture.hits.instance_id == instance]
                assert (np.abs(pixels - 255 * expected) <= COLOUR_STEPS).all()


@pytest.mark.parametrize("count", [1, 2])
def test_a_shadow_falls_where_geometry_says(count):
    # A floor at y = 0, and a square lid at y = 1 over x and z from -0.5 to 0.5; light from straight above.
    square = Mesh.from_arrays([(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)], [(0, 1, 2), (0, 2, 3)])
    floor, lid = 2 * square.vertices, 0.5 * square.vertices + [0, 1, 0]
    scene = Scene(Mesh.from_arrays(np.vstack((floor, lid)), np.vstack((square.faces, square.faces + 4))))
    if count == 2:
        scene = Scene()
        geometry = scene.add(square)
        scene.place(geometry, affine(2 * np.eye(3)))
        scene.place(geometry, affine(np.diag([0.5, -1, 0.5]) @ [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], (0, 1, 0)))
    down = Light(direction=(0, 1, 0), sky=(0, 0, 0), ground=(0, 0, 0))
    view = clbvh.View(eye=(0, 0.5, 5), look_at=(0, 0, 0), fov=40, width=160, height=90, up="y", light=down)
    picture = clbvh.render(scene, view, shading="lambert+shadow")
    points = picture.hits.locations
    on_floor = np.abs(points[..., 1]) < 1e-6
    inside = (np.abs(points[..., [0, 2]]) < 0.499).all(axis=-1) & on_floor
    outside = (np.abs(points[..., [0, 2]]) > 0.501).any(axis=-1) & on_floor
    assert inside.sum() > 40
    assert (picture.rgb[inside] == 0).all()
    assert (picture.rgb[outside] > 0).all()


@pytest.mark.parametrize("shape", [BALL, SPHERE], ids=["mesh", "sphere"])
def test_convex_bodies_never_shadow_themselves(shape):
    bodies = [(affine(matrix * scale, np.array([3.0, 1.0, 0.0]) * scale), None, None)
              for scale in (1e-20, 1.0, 1e20) for matrix in MATRICES.values()]  # fmt: skip
    for distance in (1e3, 1e7, 1e11):
        place = distance * np.array([0.6, 0.3, -0.7])
        bodies.append(
            (affine(MATRICES["turned"], place), np.eye(4), Camera(tuple(np.add(place, [2, 1.5, 3])), tuple(place)))
        )
    for matrix, other, camera in bodies:
        scene = Scene()
        geometry = scene.add(shape)
        for each in (matrix, other):
            if each is not None:
                scene.place(geometry, each)
        with Renderer(scene, camera=camera, **SIZE) as renderer:
            plain, shadowed = renderer.render(shading="lambert"), renderer.render(shading="lambert+shadow")
        assert plain.hits.count > 300
        assert (plain.rgb == shadowed.rgb).all()


def test_within_a_sphere_all_is_in_its_shadow():
    light = Light(direction=(0.3, 1, 0.2), sky=(0, 0, 0), ground=(0, 0, 0))
    view = clbvh.View(width=32, height=24, light=light, camera=Camera((0.5, 0.1, 0.2), (0, 0, 0), fov=90))
    picture = clbvh.render(Spheres([[0, 0, 0]], 2.0), view, shading="lambert+shadow")
    assert not picture.hits.is_front.any()
    assert (picture.rgb == 0).all()
    normals = clbvh.render(Spheres([[0, 0, 0]], 2.0), view, shading="normal").rgb / 127.5 - 1
    assert np.abs(normals + picture.hits.locations / 2).max() < 0.01


def test_a_mesh_far_from_zero_looks_as_one_at_zero():
    near = clbvh.render(KNOT, VIEW, shading="normal")
    far = clbvh.render(clbvh.Transform(translate=(448_000, 5_411_000, 300)).apply(KNOT), VIEW, shading="normal")
    assert (np.abs(far.rgb.astype(int) - near.rgb) > 2).mean() < 0.005


def test_a_far_instance_looks_the_same_through_a_long_lens():
    # From distances of 10^7 and 10^4, with the same view of it.
    scene = Scene()
    geometry = scene.add(KNOT)
    scene.place(geometry, affine(MATRICES["mirrored"]))
    scene.place(geometry, affine(np.eye(3), (0, 2e7, 0)))
    towards = np.array([0.48, 0.36, 0.8])
    with Renderer(scene, VIEW, shading="normal") as renderer:
        far = renderer.render(camera=Camera(tuple(1e7 * towards), (0, 0, 0), fov=np.degrees(6e-7)))
        near = renderer.render(camera=Camera(tuple(1e4 * towards), (0, 0, 0), fov=np.degrees(6e-4)))
    assert far.hits.count > 500
    assert (far.hits.prim_id == near.hits.prim_id).mean() > 0.98
    assert (np.abs(far.rgb.astype(int) - near.rgb).max(axis=2) > COLOUR_STEPS).mean() < 0.02
