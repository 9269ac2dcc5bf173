"""Small pictures of a mesh and of a scene with several objects: hits first, then pixels."""

import copy
import pickle

import numpy as np
import pytest

import clbvh
from clbvh import Camera, ConfigError, Renderer, RenderOptions, Scene, Spheres, ValidationError
from clbvh.builders.build import BUILDERS
from clbvh.choices import REPORT_SHADINGS
from clbvh.rendering import built_scene, painters, picture as picture_module

VIEW = clbvh.View(width=96, height=64, up="y")
SIZE = {"width": 64, "height": 48}
KNOT = clbvh.make_shape("knot", triangles=4000, seed=1)
BALL = clbvh.make_shape("icosphere", triangles=1280)
SPHERE = Spheres([[0.1, 0.2, 0.3]], 1.0)
RED, GREEN, BLUE = (0.8, 0.1, 0.05), (0.2, 0.5, 0.15), (0.1, 0.2, 0.9)


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


def test_pixels_depend_neither_on_trees_nor_on_layouts_nor_on_bands(renderer, source, tmp_path, monkeypatch):
    expected = renderer.render(shading="lambert+shadow")
    options = [{"layout": layout} for layout in ("bvh2", "bvh4", "bvh8")]
    options += [{"builder": builder} for builder in (*BUILDERS, "brute")]
    options += 2 * [{"workers": 2, "cache": tmp_path, "build": clbvh.BuildOptions(task_threshold=500)}]
    for each in options:
        picture = clbvh.render(source, VIEW, RenderOptions(**each), shading="lambert+shadow")
        assert same_picture(picture, expected), each
    assert picture.tree_from_cache
    whole_hits = expected.hits
    monkeypatch.setattr(painters, "BAND_PIXELS", 96 * 7)
    monkeypatch.setattr(picture_module, "_CHUNK_PIXELS", 96 * 7)
    picture = clbvh.render(source, VIEW, shading="lambert+shadow")
    assert same_picture(picture, expected)
    assert all((getattr(picture.hits, name) == getattr(whole_hits, name)).all() for name in ("t", "u", "instance_id"))
    placed = sum(instance.geometry.shape.prim_count for instance in renderer.scene.instances)
    monkeypatch.setattr(built_scene, "BRUTE_LIMIT", placed - 1)
    with pytest.raises(ConfigError, match="brute"):
        clbvh.render(source, VIEW, RenderOptions(builder="brute"))


def test_every_pixel_of_a_small_picture_is_validated_and_a_wrong_one_found(source, monkeypatch):
    def render_wrongly(self, view, painter, times=None):
        colours, hits = render_rightly(self, view, painter, times)
        hits["prim_id"][20, 16] = 3
        return colours, hits

    view, render_rightly = VIEW.changed(width=40, height=30), painters.FrameRenderer.render
    assert clbvh.render(source, view, RenderOptions(validate=True)).validated_pixels == 1200
    monkeypatch.setattr(painters.FrameRenderer, "render", render_wrongly)
    with pytest.raises(ValidationError, match=r"1 of 1200 pixels differ .* column 16, row 20"):
        clbvh.render(source, view, RenderOptions(validate=True))


def test_the_report_adds_up_and_a_picture_can_be_copied(renderer):
    picture = renderer.render()
    report = picture.report()
    assert (report["rays"], report["hits"]) == (96 * 64, picture.hits.count)
    times = report["timings_ms"]
    assert sum(ms for name, ms in times.items() if name != "total") == pytest.approx(times["total"], rel=0.01)
    for copied in (pickle.loads(pickle.dumps(picture)), copy.deepcopy(picture)):
        assert (copied.rgb.tobytes(), copied.hits.t.tobytes()) == (picture.rgb.tobytes(), picture.hits.t.tobytes())
        assert copied.report() == report


@pytest.mark.parametrize("shape", [BALL, SPHERE], ids=["mesh", "sphere"])
def test_convex_bodies_never_shadow_themselves(shape):
    # Of any size, and far from another one.
    places = [(matrix, scale, scale * np.array([3.0, 1, 0])) for matrix in MATRICES.values() for scale in (1e-20, 1e20)]
    places += [(MATRICES["turned"], 1.0, far * np.array([0.6, 0.3, -0.7])) for far in (1e3, 1e7, 1e11)]
    for matrix, scale, place in places:
        scene = Scene(shape) if scale == 1 else Scene()
        scene.place(scene.add(shape), affine(matrix * scale, place))
        camera = Camera(tuple(np.add(place, [2, 1.5, 3])), tuple(place)) if scale == 1 else None
        with Renderer(scene, camera=camera, **SIZE) as renderer:
            plain, shadowed = renderer.render(shading="lambert"), renderer.render(shading="lambert+shadow")
        assert plain.hits.count > 300
        assert (plain.rgb == shadowed.rgb).all()


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
    assert (np.abs(far.rgb.astype(int) - near.rgb).max(axis=2) > 1).mean() < 0.02
