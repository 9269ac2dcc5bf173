"""Small pictures of scenes with several objects: hits first, then pixels."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import clbvh
from clbvh import Camera, Light, Mesh, Renderer, RenderOptions, Scene, Spheres
from clbvh.builders.build import BUILDERS
from clbvh.choices import REPORT_SHADINGS
from clbvh.errors import ConfigError, SceneError, ValidationError
from clbvh.rendering import built_scene as brute_limit, painters as painters_module

from ..concurrency.threads import run_in_threads

SIZE = (96, 64)
LAYOUTS = ("bvh2", "bvh4", "bvh8")
VIEW = clbvh.View(width=SIZE[0], height=SIZE[1], up="y")

KNOT = clbvh.make_shape("knot", triangles=4000, seed=1)
GROUND = clbvh.make_shape("terrain", triangles=2000, seed=7)
BALL = clbvh.make_shape("icosphere", triangles=1280)

EVEN = Light(colour=(0, 0, 0), sky=(1, 1, 1), ground=(1, 1, 1))
DOWN = Light(direction=(0, 1, 0), sky=(0, 0, 0), ground=(0, 0, 0))

RED, GREEN, BLUE = (0.8, 0.1, 0.05), (0.2, 0.5, 0.15), (0.1, 0.2, 0.9)

# Colours that float32 rounds to one side or the other.
COLOUR_STEPS = 1


def affine(linear, translation=(0.0, 0.0, 0.0)):
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    matrix[:3, 3] = translation
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
    ground, knot = scene.add(GROUND), scene.add(KNOT)
    crowd = scene.add(Spheres(generator.normal(size=(40, 3)), generator.uniform(0.1, 0.5, 40), name="crowd"))
    scene.place(ground, affine(np.eye(3), (0, -3, 0)), colour=GREEN)
    scene.place(knot, affine(rotation(5), (-2, 0, 0)))
    scene.place(knot, affine(0.6 * MATRICES["mirrored"], (0, 0, 2.5)), colour=BLUE)
    scene.place(crowd, affine(0.5 * MATRICES["stretched"], (2, 0.5, 0)), colour=RED)
    return scene


@pytest.fixture(scope="module")
def renderer():
    with Renderer(still_life(), VIEW) as opened:
        yield opened


def same_picture(one, other):
    return (one.rgb == other.rgb).all() and (one.found == other.found).all() and one.camera == other.camera


class TestHits:
    def test_they_are_those_of_the_tracer(self, renderer):
        picture = renderer.render()
        with clbvh.Tracer(renderer.scene) as tracer:
            traced = tracer.closest_hit(*picture.camera.rays(*SIZE))
        hits = picture.hits
        assert set(np.unique(hits.instance_id)) == {-1, 0, 1, 2, 3}
        assert set(np.unique(hits.geometry_id)) == {-1, 0, 1, 2}
        same = (traced.instance_id == hits.instance_id) & (traced.prim_id == hits.prim_id)
        # The kernel makes its rays in float32: at an edge the neighbour may be hit.
        assert same.mean() > 0.995
        for name in ("t", "u", "v", "geometry_id", "is_front"):
            assert np.array_equal(getattr(traced, name)[same], getattr(hits, name)[same]), name

    def test_depth_is_that_of_the_hits(self, renderer):
        picture = renderer.render()
        locations = picture.hits.locations[picture.hits.is_hit]
        forward = picture.camera.axes()[2]
        expected = (locations - np.asarray(picture.camera.eye)) @ forward
        np.testing.assert_allclose(picture.depth[picture.hits.is_hit], expected, rtol=1e-9)

    def test_an_instance_that_no_ray_sees_is_not_drawn(self):
        scene = Scene()
        view = clbvh.View(width=40, height=40)
        ball = scene.add(BALL)
        scene.place(ball, affine(np.eye(3), (3, 0, 0)))
        scene.place(ball, affine(np.eye(3), (-3, 0, 0)), mask=0)
        assert set(np.unique(clbvh.render(scene, view).hits.instance_id)) == {-1, 0}


class TestPixels:
    @pytest.mark.parametrize("shading", REPORT_SHADINGS)
    def test_each_shading_looks_as_it_did(self, renderer, shading, compare_with_reference):
        compare_with_reference(f"scene-{shading.replace('+', '-')}", renderer.render(shading=shading).rgb)

    @pytest.mark.parametrize("layout", LAYOUTS)
    def test_layouts_agree_to_the_byte(self, renderer, layout):
        with Renderer(still_life(), VIEW, options=RenderOptions(layout=layout)) as other:
            assert other.layout == layout
            for shading in REPORT_SHADINGS:
                assert same_picture(other.render(shading=shading), renderer.render(shading=shading))

    @pytest.mark.parametrize("kind", MATRICES)
    @pytest.mark.parametrize("shading", REPORT_SHADINGS)
    def test_an_instance_looks_as_the_mesh_that_is_moved(self, kind, shading):
        matrix = affine(MATRICES[kind], (1, 2, 3))
        moved = Mesh.from_arrays(KNOT.vertices @ matrix[:3, :3].T + matrix[:3, 3], KNOT.faces)
        scene = Scene()
        view = clbvh.View(width=SIZE[0], height=SIZE[1], shading=shading)
        scene.place(scene.add(KNOT), matrix)
        one, other = clbvh.render(scene, view), clbvh.render(moved, width=SIZE[0], height=SIZE[1], shading=shading)
        assert one.mesh is None
        # The cameras differ by the rounding of vertices to float32.
        np.testing.assert_allclose(one.camera.eye, other.camera.eye, rtol=0, atol=1e-5)
        assert (one.hits.prim_id == other.hits.prim_id).mean() > 0.995
        wrong = np.abs(one.rgb.astype(int) - other.rgb).max(axis=2) > COLOUR_STEPS
        assert wrong.mean() < 0.005

    def test_colours_are_those_of_the_instances(self):
        scene = Scene()
        view = clbvh.View(width=60, height=30, shading="lambert", surface=(0.5, 0.5, 0.5), light=EVEN)  # fmt: skip
        ball = scene.add(BALL)
        for number, colour in enumerate([RED, None, BLUE]):
            scene.place(ball, affine(np.eye(3), (3 * number, 0, 0)), colour=colour)
        with Renderer(scene, view) as renderer:
            for surface in [(0.5, 0.5, 0.5), (0.0, 1.0, 0.0)]:
                picture = renderer.render(surface=surface)
                for instance, colour in enumerate([RED, surface, BLUE]):
                    linear = np.array(colour)
                    expected = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
                    pixels = picture.rgb[picture.hits.instance_id == instance]
                    assert len(pixels) > 50
                    assert (np.abs(pixels - 255 * expected) <= COLOUR_STEPS).all()

    def test_a_shadow_falls_from_one_instance_on_another(self):
        # A floor at y = 0, and a square lid at y = 1 over x and z from -0.5 to 0.5; light from straight above.
        square = Mesh.from_arrays([(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)], [(0, 1, 2), (0, 2, 3)])
        scene = Scene()
        view = clbvh.View(eye=(0, 0.5, 5), look_at=(0, 0, 0), fov=40, width=160, height=90, up="y", light=DOWN)
        geometry = scene.add(square)
        scene.place(geometry, affine(2 * np.eye(3)))
        scene.place(geometry, affine(np.diag([0.5, -1, 0.5]) @ [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], (0, 1, 0)))
        picture = clbvh.render(scene, view, shading="lambert+shadow")
        points, on_floor = picture.hits.locations, picture.hits.instance_id == 0
        inside = (np.abs(points[..., [0, 2]]) < 0.499).all(axis=-1) & on_floor
        outside = (np.abs(points[..., [0, 2]]) > 0.501).any(axis=-1) & on_floor
        assert inside.sum() > 40
        assert (picture.rgb[inside] == 0).all()
        assert (picture.rgb[outside] > 0).all()

    def test_bands_do_not_show(self, renderer, monkeypatch):
        monkeypatch.setattr(painters_module, "BAND_PIXELS", SIZE[0] * 7)
        with Renderer(still_life(), VIEW) as banded:
            assert same_picture(banded.render(), renderer.render())


class TestPrecision:
    @pytest.mark.parametrize("scale", [1e-20, 1e-6, 1.0, 1e20])
    @pytest.mark.parametrize("kind", MATRICES)
    @pytest.mark.parametrize("shape", [BALL, Spheres([[0.1, 0.2, 0.3]], 1.0)], ids=["mesh", "sphere"])
    def test_no_acne_at_any_scale(self, shape, kind, scale):
        # A convex body never shadows itself: shadows may only be where the light does not reach anyway.
        scene = Scene()
        view = clbvh.View(width=64, height=48)
        scene.place(scene.add(shape), affine(scale * MATRICES[kind], np.array([3.0, 1.0, 0.0]) * scale))
        with Renderer(scene, view) as renderer:
            plain, shadowed = renderer.render(shading="lambert"), renderer.render(shading="lambert+shadow")
        assert plain.hits.count > 300
        assert (plain.rgb == shadowed.rgb).all()

    @pytest.mark.parametrize("distance", [1e3, 1e7, 1e11])
    @pytest.mark.parametrize("shape", [BALL, Spheres([[0.1, 0.2, 0.3]], 1.0)], ids=["mesh", "sphere"])
    def test_no_acne_far_from_another_object(self, shape, distance):
        scene = Scene()
        view = clbvh.View(width=64, height=48)
        geometry = scene.add(shape)
        place = distance * np.array([0.6, 0.3, -0.7])
        scene.place(geometry)
        scene.place(geometry, affine(MATRICES["turned"], place))
        camera = Camera(tuple(np.add(place, [2, 1.5, 3])), tuple(place))
        with Renderer(scene, view) as renderer:
            plain = renderer.render(camera=camera, shading="lambert")
            shadowed = renderer.render(camera=camera, shading="lambert+shadow")
        assert set(np.unique(plain.hits.instance_id)) == {-1, 1}
        assert (plain.rgb == shadowed.rgb).all()

    def test_a_small_sphere_in_a_large_cloud_has_no_acne(self):
        spheres = Spheres([[0, 0, 0], [1, 1, 1], [-1, -1, -1]], [1e-4, 1e-3, 1e-3])
        scene = Scene()
        view = clbvh.View(width=64, height=48)
        scene.place(scene.add(spheres), affine(MATRICES["mirrored"]))
        camera = Camera((0, 1e-4, 4e-4), (0, 0, 0))
        with Renderer(scene, view) as renderer:
            plain = renderer.render(camera=camera, shading="lambert")
            assert plain.hits.count > 300
            assert (renderer.render(camera=camera, shading="lambert+shadow").rgb == plain.rgb).all()

    def test_within_a_sphere_all_is_in_its_shadow(self):
        scene = Scene()
        view = clbvh.View(width=32, height=24, light=Light(direction=(0.3, 1, 0.2), sky=(0, 0, 0), ground=(0, 0, 0)))
        scene.place(scene.add(Spheres([[0, 0, 0]], 2.0)))
        picture = clbvh.render(scene, view, camera=Camera((0.5, 0.1, 0.2), (0, 0, 0), fov=90))
        assert picture.hits.count == 32 * 24
        assert not picture.hits.is_front.any()
        assert (picture.rgb == 0).all()
        normals = clbvh.render(scene, view, camera=picture.camera, shading="normal").rgb / 127.5 - 1
        inwards = -picture.hits.locations / 2
        assert np.abs(normals - inwards).max() < 0.01

    def test_a_far_instance_looks_the_same_through_a_long_lens(self):
        # From distances of 10^7 and 10^4, with the same view of it.
        scene = Scene()
        view = clbvh.View(width=SIZE[0], height=SIZE[1], shading="normal", light=Light(direction=(1, 1, 0)))
        geometry = scene.add(KNOT)
        scene.place(geometry, affine(MATRICES["mirrored"]))
        scene.place(geometry, affine(np.eye(3), (0, 2e7, 0)))
        towards = np.array([0.48, 0.36, 0.8])
        with Renderer(scene, view) as renderer:
            far = renderer.render(camera=Camera(tuple(1e7 * towards), (0, 0, 0), fov=np.degrees(6e-7)))
            near = renderer.render(camera=Camera(tuple(1e4 * towards), (0, 0, 0), fov=np.degrees(6e-4)))
        assert far.hits.count > 500
        assert set(np.unique(far.hits.instance_id)) == {-1, 0}
        assert (far.hits.prim_id == near.hits.prim_id).mean() > 0.98
        wrong = np.abs(far.rgb.astype(int) - near.rgb).max(axis=2) > COLOUR_STEPS
        assert wrong.mean() < 0.02


class TestRenderer:
    def test_one_mesh_in_its_place_is_drawn_as_a_mesh(self):
        scene = Scene()
        view = clbvh.View(width=SIZE[0], height=SIZE[1])
        scene.place(scene.add(KNOT))
        one, other = clbvh.render(scene, view), clbvh.render(KNOT, width=SIZE[0], height=SIZE[1])
        assert one.mesh is KNOT
        assert same_picture(one, other)
        assert set(np.unique(one.hits.instance_id)) == {-1, 0}

    def test_one_mesh_with_a_colour_has_it(self):
        scene = Scene()
        view = clbvh.View(width=SIZE[0], height=SIZE[1])
        scene.place(scene.add(KNOT), colour=BLUE)
        plain = clbvh.render(KNOT, width=SIZE[0], height=SIZE[1], surface=BLUE)
        picture = clbvh.render(scene, view, surface=RED)
        assert (np.abs(picture.rgb.astype(int) - plain.rgb).max(axis=2) > COLOUR_STEPS).mean() < 0.005

    def test_a_renderer_has_the_objects_of_its_beginning(self):
        scene = still_life()
        with Renderer(scene, VIEW) as renderer:
            before = renderer.render()
            scene.place(scene.geometries[1], affine(5 * np.eye(3)))
            assert same_picture(renderer.render(), before)
            assert repr(renderer).startswith("Renderer('4 instances', device=")

    def test_a_turntable_shows_all_objects_all_the_way(self, renderer):
        cameras = renderer.turntable(8, width=60, height=40)
        found = np.array([renderer.render(camera=camera, width=60, height=40).hits.is_hit for camera in cameras])
        assert found.any(axis=0)[1:-1, 1:-1].mean() > 0.3
        assert not found[:, [0, -1]].any()
        assert not found[:, :, [0, -1]].any()

    def test_the_camera_sees_all_and_wastes_no_room(self, renderer):
        found = renderer.render(width=300, height=200).hits.is_hit
        rows, columns = (np.flatnonzero(found.any(axis=axis)) for axis in (1, 0))
        # The margin is 3 % on each side.
        assert min(rows[0], 199 - rows[-1], columns[0], 299 - columns[-1]) >= 4
        assert rows[-1] - rows[0] > 0.9 * 200 or columns[-1] - columns[0] > 0.9 * 300

    def test_threads_share_a_renderer(self, renderer):
        cameras = [renderer.camera.orbit(60 * number) for number in range(4)]
        expected = [renderer.render(camera=camera, width=50, height=30) for camera in cameras]

        def draw_all(seed):
            for number in np.random.default_rng(seed).permutation(4):
                assert same_picture(renderer.render(camera=cameras[number], width=50, height=30), expected[number])

        run_in_threads(*(lambda seed=seed: draw_all(seed) for seed in range(4)))

    def test_the_report_counts_all_objects(self, renderer):
        picture = renderer.render()
        report = picture.report()
        assert report["mesh"] == picture.name == "4 instances"
        assert report["triangles"] == GROUND.face_count + KNOT.face_count
        assert report["spheres"] == 40
        assert (report["geometries"], report["instances"]) == (3, 4)
        assert report["placed_primitives"] == GROUND.face_count + 2 * KNOT.face_count + 40
        assert report["nodes"] > report["depth"] > 3
        assert report["hits"] == picture.hits.count
        times = report["timings_ms"]
        assert list(times) == list(clbvh.render(KNOT, width=8, height=8).timings)
        assert sum(times[name] for name in times if name != "total") == pytest.approx(times["total"])

    @pytest.mark.parametrize("duplicate", [lambda thing: pickle.loads(pickle.dumps(thing)), copy.copy, copy.deepcopy])
    def test_a_picture_can_be_copied(self, renderer, duplicate):
        picture = renderer.render(width=16, height=12)
        copied = duplicate(picture)
        assert copied.rgb.tobytes() == picture.rgb.tobytes()
        assert copied.hits.t.tobytes() == picture.hits.t.tobytes()
        assert (copied.hits.instance_id == picture.hits.instance_id).all()
        assert copied.report()["nodes"] == picture.report()["nodes"]

    def test_trees_come_from_workers_and_from_the_cache(self, renderer, tmp_path):
        expected = renderer.render()
        options = RenderOptions(workers=2, cache=tmp_path)
        for from_cache in (False, True):
            picture = clbvh.render(still_life(), VIEW, options=options)
            assert same_picture(picture, expected)
            assert picture.tree_from_cache is from_cache
        assert len(list(tmp_path.iterdir())) == 3

    def test_an_empty_scene_says_so(self):
        scene = Scene()
        scene.add(BALL)
        for empty in (Scene(), scene):
            with pytest.raises(SceneError, match="the scene is empty"):
                Renderer(empty)

    def test_without_trees_the_picture_is_the_same(self, renderer):
        picture = clbvh.render(still_life(), VIEW, options=RenderOptions(builder="brute", validate=True))
        assert same_picture(picture, renderer.render())
        assert (picture.layout, picture.workers) == ("brute", 1)
        top = picture.scene.top
        assert (picture.report()["nodes"], picture.report()["depth"]) == (top.node_count, top.depth)

    def test_brute_refuses_a_scene_that_would_take_forever(self, monkeypatch):
        # One of the two geometries is placed twice.
        monkeypatch.setattr(brute_limit, "BRUTE_LIMIT", GROUND.face_count + 2 * KNOT.face_count + 39)
        with pytest.raises(ConfigError, match="brute"):
            Renderer(still_life(), VIEW, options=RenderOptions(builder="brute"))

    @pytest.mark.parametrize("builder", BUILDERS)
    def test_every_builder_builds_the_trees(self, renderer, builder):
        assert same_picture(clbvh.render(still_life(), VIEW, options=RenderOptions(builder=builder)), renderer.render())


class TestValidation:
    def test_every_pixel_of_a_small_picture_is_validated(self, renderer):
        options = RenderOptions(validate=True)
        with Renderer(still_life(), VIEW, options=options) as checked:
            picture = checked.render(width=40, height=30)
            assert picture.validated_pixels == 40 * 30
            assert same_picture(picture, renderer.render(width=40, height=30))

    @pytest.mark.parametrize(("field", "value"), [("prim_id", 3), ("instance_id", 2)])
    def test_a_wrong_pixel_is_found(self, monkeypatch, field, value):
        def render_wrongly(self, view, painter, times=None):
            colours, hits = render_rightly(self, view, painter, times)
            hits[field][20, 16] = value
            return colours, hits

        render_rightly = painters_module.FrameRenderer.render
        monkeypatch.setattr(painters_module.FrameRenderer, "render", render_wrongly)
        with pytest.raises(ValidationError, match=r"1 of 1200 pixels differ .* column 16, row 20"):
            clbvh.render(still_life(), VIEW, options=RenderOptions(validate=True), width=40, height=30)
