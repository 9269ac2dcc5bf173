"""Small pictures of a mesh and of a scene in all shadings: references, hits and pixels, and answers by formula."""

import copy
import itertools
import pickle
from types import SimpleNamespace

import numpy as np
import pytest

import clbvh
from clbvh import (
    Appearance,
    Camera,
    ConfigError,
    Light,
    Material,
    Mesh,
    Renderer,
    RenderOptions,
    Scene,
    Spheres,
    ValidationError,
)
from clbvh.builders.build import BUILDERS
from clbvh.choices import REPORT_SHADINGS
from clbvh.geometry.appearance.srgb import srgb_to_linear
from clbvh.rendering import (
    frame,
    painters,
    picture as picture_module,
    renderer as renderer_module,
)
from clbvh.trace.world import trees

from ..unit.trace.scene_states import affine

VIEW = clbvh.View(width=96, height=64, up="y")
KNOT = clbvh.make_shape("knot", triangles=4000, seed=1)
RED, GREEN, BLUE = (0.8, 0.1, 0.05), (0.2, 0.5, 0.15), (0.1, 0.2, 0.9)


def rotation(seed):
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


MATRICES = {
    "stretched": rotation(2) @ np.diag([2.0, 0.5, 1.0]),
    "mirrored": rotation(3) @ np.diag([1.0, -1.0, 1.0]),
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
def renderer(request, _opened_device):
    with Renderer(KNOT if request.param == "knot" else still_life(), VIEW) as opened:
        opened.kind = request.param
        yield opened


@pytest.fixture
def source(renderer):
    return renderer.mesh or renderer.scene


def same_picture(one, other):
    return (one.rgb == other.rgb).all() and (one.found == other.found).all() and one.camera == other.camera


@pytest.mark.on_both
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
    monkeypatch.setattr(frame, "BAND_PIXELS", 96 * 7)
    monkeypatch.setattr(picture_module, "_CHUNK_PIXELS", 96 * 7)
    picture = clbvh.render(source, VIEW, shading="lambert+shadow")
    assert same_picture(picture, expected)
    assert all((getattr(picture.hits, name) == getattr(whole_hits, name)).all() for name in ("t", "u", "instance_id"))
    placed = sum(instance.geometry.shape.prim_count for instance in renderer.scene.instances)
    monkeypatch.setattr(trees, "BRUTE_LIMIT", placed - 1)
    with pytest.raises(ConfigError, match="brute"):
        clbvh.render(source, VIEW, RenderOptions(builder="brute"))


def test_every_pixel_of_a_small_picture_is_validated_and_a_wrong_one_found(source, monkeypatch):
    def render_wrongly(*arguments):
        colours, hits = render_rightly(*arguments)
        hits["prim_id"][20, 16] = 3
        return colours, hits

    view, render_rightly = VIEW.changed(width=40, height=30), renderer_module.render_frame
    assert clbvh.render(source, view, RenderOptions(validate=True)).validated_pixels == 1200
    monkeypatch.setattr(renderer_module, "render_frame", render_wrongly)
    with pytest.raises(ValidationError, match=r"1 of 1200 pixels differ .* column 16, row 20"):
        clbvh.render(source, view, RenderOptions(validate=True))


def test_the_report_adds_up_and_a_picture_can_be_copied(renderer):
    picture = renderer.render()
    report, times = picture.report(), picture.report()["timings_ms"]
    assert sum(ms for name, ms in times.items() if name != "total") == pytest.approx(times["total"], rel=0.01)
    for copied in (pickle.loads(pickle.dumps(picture)), copy.deepcopy(picture)):
        assert (copied.rgb.tobytes(), copied.hits.t.tobytes()) == (picture.rgb.tobytes(), picture.hits.t.tobytes())
        assert copied.report() == report


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


DARK = Light(direction=(0, 0, 1), colour=(0, 0, 0), sky=(0, 0, 0), ground=(0, 0, 0))
CORNERS = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
FACES = np.array([(0, 1, 2), (0, 2, 3)])
UVS = (CORNERS[FACES][..., :2] + 1) / 2


def make_square(**appearance):
    """A square that fills the picture of `show`, the outermost half pixel included."""
    return Mesh.from_arrays(CORNERS, FACES, appearance=Appearance(**appearance))


def show(source, side=1, **settings):
    """The picture of a square from one of its sides, with its film."""
    fov = np.degrees(2 * np.arctan(1 / 4))
    view = clbvh.View(eye=(0, 0, 4 * side), look_at=(0, 0, 0), up="y", fov=fov, width=20, height=20, ground=False)
    with Renderer(source, view, smooth=0.0, **settings) as renderer:
        return renderer.render(keeps_film=True)


@pytest.mark.on_both
def test_studio_looks_as_it_did_whatever_the_bands_and_launches(session, compare_with_reference, monkeypatch):
    compare_with_reference("knot-studio", clbvh.render(KNOT, VIEW).rgb)
    rows = [{"shading": "ao", "samples": 7}, {"samples": 7, "seed": 0}]
    wholes = [clbvh.render(KNOT, VIEW, **row).rgb for row in rows]
    # A seed changes the noise alone.
    other = clbvh.render(KNOT, VIEW, samples=7, seed=1).rgb
    assert (other != wholes[1]).any()
    assert abs(other.mean() - wholes[1].mean()) < 0.3
    # Two samples in each launch, and 7 rows in each band.
    monkeypatch.setattr(frame, "BAND_PIXELS", VIEW.width * 7)
    with Renderer(KNOT, VIEW) as renderer:
        for row, whole in zip(rows, wholes, strict=True):
            assert np.array_equal(renderer.render(launch_s=0.0, **row).rgb, whole)


@pytest.mark.on_both
def test_ambient_occlusion_looks_as_it_did_and_is_white_in_the_open_and_black_in_a_box(session, compare_with_reference):
    compare_with_reference("knot-ao", clbvh.render(KNOT, VIEW, shading="ao").rgb)
    assert (show(make_square(), shading="ao").rgb[1:-1, 1:-1] == 255).all()
    # The reach of occlusion is a share of the scene's size, which a far triangle makes large.
    cube = clbvh.make_shape("cube", triangles=12)
    far = np.array([(40, 40, 40), (41, 40, 40), (40, 41, 40)])
    mesh = Mesh.from_arrays(
        np.vstack((cube.vertices, far)), np.vstack((cube.faces, [np.arange(3) + len(cube.vertices)]))
    )
    view = {"eye": cube.vertices.mean(axis=0), "fov": 60, "width": 16, "height": 16, "frame": "all"}
    assert (clbvh.render(mesh, shading="ao", look_at=view["eye"] + [0, 0, 1], **view).rgb == 0).all()


def test_a_picture_that_is_stopped_has_the_samples_that_were_taken(monkeypatch):
    with Renderer(KNOT, VIEW) as renderer:
        stopped = renderer.render(samples=8, is_stopped=lambda: True, keeps_film=True)
        whole = renderer.render(samples=2, keeps_film=True)
        assert stopped.samples == 2
        assert np.array_equal(stopped.rgb, whole.rgb)
        assert np.array_equal(stopped.film, whole.film)
    monkeypatch.setattr(frame, "BAND_PIXELS", VIEW.width * 7)
    launches = itertools.count(1)
    with Renderer(KNOT, VIEW) as renderer:
        # Of a picture in bands they are those of the poorest, wherever that is.
        assert renderer.render(samples=8, launch_s=0.0, is_stopped=lambda: next(launches) in (6, 7)).samples == 2
        # Bands have shares of the time; each launch reads the clock twice.
        now = itertools.count()
        monkeypatch.setattr(painters, "time", SimpleNamespace(perf_counter=lambda: float(next(now))))
        assert renderer.render(time_limit_s=8 * VIEW.height).samples >= 6


def test_colours_are_stored_as_they_were_given():
    # Light that the surface sends out, and no other.
    for colour in ((10, 128, 250), (0, 255, 64)):
        material = Material(emission=tuple(srgb_to_linear(np.array(colour) / 255)))
        picture = show(make_square(materials=(material,)), light=DARK)
        assert (np.abs(picture.rgb[1:-1, 1:-1].astype(int) - colour) <= 1).all()
    # Row 0 of a texture is the top: red and green above blue and white.
    corners = np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (255, 255, 255)]], np.uint8)
    texture = clbvh.Texture("checker", corners.repeat(64, axis=0).repeat(64, axis=1))
    material = Material(emission=(1, 1, 1), emission_texture=texture)
    rgb = show(make_square(uvs=UVS, materials=(material,)), light=DARK).rgb
    assert (rgb[[5, 5, 15, 15], [5, 15, 5, 15]] == corners.reshape(4, 3)).all()


@pytest.mark.on_both
@pytest.mark.parametrize("shading", ["studio", "path", "albedo"])
def test_texels_that_are_squares_look_like_squares(session, shading):
    rng = np.random.default_rng(0)
    few = rng.integers(256, size=(4, 4, 3), dtype=np.uint8)
    films = []
    # Of many texels those between two colours cover next to nothing.
    for pixels, filtered in (
        (few, "nearest"),
        (few.repeat(512, axis=0).repeat(512, axis=1), "linear"),
        (few, "linear"),
    ):
        texture = clbvh.Texture("few", pixels, filter=filtered)
        names = ("base_colour", "metallic_roughness", "emission", "normal")
        material = Material(emission=(0.1,) * 3, **dict.fromkeys((f"{name}_texture" for name in names), texture))
        square = make_square(uvs=UVS, materials=[material])
        films.append(show(square, samples=4, shading=shading).film[1:-1, 1:-1, :3])
    np.testing.assert_allclose(films[0], films[1], rtol=0.02, atol=0.01)
    assert np.abs(films[0] - films[2]).mean() > 0.02


def test_transparent_pictures_have_bright_edges_and_black_shadows():
    square = make_square(materials=[Material(emission=(1, 1, 1))])
    view = {"eye": (0, 0, 6), "look_at": (0.013, 0.02, 0), "up": (0.2, 1, 0), "width": 40, "height": 40}
    picture = clbvh.render(square, transparent=True, ground=False, light=DARK, **view)
    assert ((picture.alpha > 0) & (picture.alpha < 255)).sum() > 20
    assert set(np.unique(picture.alpha)) <= {round(255 * covered / 16) for covered in range(17)}
    # Black light elsewhere would darken the edge if colours were multiplied by alpha.
    assert (picture.rgb[picture.alpha > 0] == 255).all()
    assert (picture.rgb[picture.alpha == 0] == 0).all()
    shadow = clbvh.render(KNOT, VIEW, transparent=True)
    is_shadow = (shadow.hits.prim_id < 0) & (shadow.alpha > 60)
    assert is_shadow.sum() > 20
    assert (shadow.rgb[is_shadow].min(axis=-1) == 0).any()


def test_shadows_of_light_along_an_axis_are_those_of_light_nearby():
    # Such a light is parallel to sides of the box around the objects, outside which no shadow is looked for.
    ball = clbvh.make_shape("icosphere", triangles=320)
    for up in np.eye(3):
        view = {"up": up, "eye": 4 * up + 3 * np.roll(up, 1), "look_at": (0, 0, 0), "width": 48, "height": 48}
        pair = (clbvh.render(ball, transparent=True, light_direction=towards, **view) for towards in (up, up + 1e-6))
        along, near = (picture.alpha.astype(int) for picture in pair)
        is_shadow = (near > 0) & (near < 255)
        assert is_shadow.sum() > 48
        assert np.abs(along - near)[is_shadow].mean() < 1.0


def test_the_filmic_curve_is_that_of_its_source():
    for exposure in (0.0, 2.0):
        picture = show(make_square(), tone_curve="filmic", exposure=exposure, samples=2)
        x = 2.0**exposure * picture.film[..., :3].astype(float)
        mapped = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)
        encoded = np.where(mapped <= 0.0031308, 12.92 * mapped, 1.055 * mapped ** (1 / 2.4) - 0.055)
        assert np.abs(255 * encoded - picture.rgb).max() < 0.51


def test_a_room_is_lit_from_the_eye():
    cube = clbvh.make_shape("cube", triangles=12)
    eye = cube.vertices.mean(axis=0)
    with Renderer(cube, eye=eye, look_at=eye - [0, 0, 1], width=32, height=24, ground=False) as renderer:
        assert renderer.render().rgb.mean() > 150
        # A light that was asked for stays outside.
        assert renderer.render(light_direction=(0, 1, 0)).rgb.mean() < 140


TEXEL = (190, 90, 220)
BEND = 2 * np.array(TEXEL) / 255 - 1
MAP = clbvh.Texture("tilt", np.tile(np.uint8(TEXEL), (2, 2, 1)), is_srgb=False)


def film_of_square(side=1, normal=None, size=(1, 1, 1), uvs=None, **material):
    """The film of a placed square in directed light: rays of ambient light might meet the plane of a tilted normal."""
    normals = None if normal is None else np.tile(np.asarray(normal, float), (2, 3, 1))
    scene = Scene()
    square = make_square(normals=normals, uvs=uvs, materials=[Material("a", roughness=0.4, **material)])
    scene.place(scene.add(square), clbvh.Transform(size))
    light = Light(tuple(side * np.array((0.3, 0.4, 1))), sky=(0, 0, 0), ground=(0, 0, 0))
    return show(scene, side, light=light, samples=2).film[1:-1, 1:-1, :3]


def test_a_constant_map_of_normals_is_a_tilted_normal():
    for degrees, mirror, side, scale in ((0, 1, 1, 1), (130, 1, -1, 0.5), (130, -1, 1, -1), (20, -1, -1, 0)):
        # The directions of u and v.
        along_u = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0])
        along_v = mirror * np.cross((0, 0, 1), along_u)
        uvs = np.stack((CORNERS @ along_u, CORNERS @ along_v), axis=-1)[FACES]
        meant = scale * (BEND[0] * along_u + BEND[1] * along_v) + BEND[2] * np.array([0, 0, 1])
        # Placed meshes are bent, too, mirrored or not, and so are facets.
        for size, normal in (((1, 1, 1), None), ((-1, 1, 1), (0, 0, 1)), ((2, 2, 2), (0, 0, 1))):
            found = film_of_square(side, normal, size, uvs, normal_texture=MAP, normal_scale=scale)
            np.testing.assert_allclose(found, film_of_square(side, meant, size), rtol=1e-3)
    # A texture without coordinates bends nothing.
    assert np.array_equal(film_of_square(normal_texture=MAP), film_of_square())


def test_flat_faces_look_as_without_normals_at_their_corners():
    cube = clbvh.make_shape("cube", triangles=12)
    turned = Mesh.from_arrays(cube.vertices @ rotation(7).T, cube.faces)
    smooth, flat = (clbvh.render(turned, VIEW, shading="studio", samples=2, smooth=angle) for angle in (40.0, 0.0))
    assert np.array_equal(smooth.rgb, flat.rgb)
    assert smooth.hits.count > 300


def test_meshes_with_the_same_normals_are_flat_by_themselves():
    looks = Appearance(normals=np.tile([0.0, 0, 1], (2, 3, 1)), materials=[Material("a", roughness=0.4)])
    slopes = np.zeros((4, 3)), CORNERS[:, :1] * [0, 0, 1]
    flat, bent = (Mesh.from_arrays(CORNERS + slope, FACES, appearance=looks) for slope in slopes)
    films = []
    for shapes in ((bent,), (flat, bent)):
        scene = Scene()
        for shape in shapes:  # what is hidden comes first
            scene.place(scene.add(shape), clbvh.Transform(translate=(0, 0, 0 if shape is bent else -9)))
        view = clbvh.View(eye=(0, 0, 4), look_at=(0, 0, 0), fov=10, width=20, height=20, ground=False)
        with Renderer(scene, view, samples=2, light=Light((1, 0, 1), sky=(0, 0, 0), ground=(0, 0, 0))) as renderer:
            films.append(renderer.render(keeps_film=True).film)
    np.testing.assert_allclose(films[1], films[0], rtol=1e-3)
