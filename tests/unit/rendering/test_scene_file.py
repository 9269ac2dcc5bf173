"""Scene files: their keys, the messages about invalid ones, and the views that saved scenes hold."""

from __future__ import annotations

import json

import imageio.v3 as imageio
import numpy as np
import pytest

import clbvh
from clbvh import Cut, Light, Transform, View, Wireframe
from clbvh.errors import SceneError
from clbvh.rendering.cameras.projection import Fisheye
from clbvh.rendering.scene_file import parse_scene_file, plain_view, read_scene_file, save_scene, view_of_plain
from clbvh.scene.copies import Grid, Scatter

OBJECTS = """
[[object]]
label = "ground"
shape = "terrain"
triangles = 500
seed = 7
height = 1.5
colour = [0.1, 0.2, 0.3]
scale = [2, 1, 2]
rotate = [0, 90, 0]
translate = [1, 2, 3]

[[object]]
name = "bunny"
mask = 5
matrix = [[1, 0, 0, 4], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]
repeat = {on = "ground", count = 30, seed = 4, scale = [0.5, 2], align = "normal", turn = false}

[[object]]
path = "parts/wheel.ply"
[object.repeat]
grid = [3, 1, 2]
spacing = [1, 0, 2.5]

[[object]]
spheres = "galaxy"
count = 50
seed = 3
arms = 4

[[object]]
spheres = "atoms.csv"
radii = 0.5

[[object]]
centres = [[0, 0, 0], [1, 2, 3]]
radii = [1, 0.5]
"""

VIEW = """
[view]
eye = [0, 0, 9]
look_at = [0, 1, 0]
up = [0, 1, 0.5]
projection = "fisheye:220.5"
cut = "y<2"
width = 64
shading = "path"
samples = 3
surface = [1, 0, 0]
background = [[0, 0, 0], [1, 1, 1]]
environment = "sky.exr"
environment_rotation = 45

[view.light]
direction = [1, 1, 0]
sky = [0.1, 0.2, 0.3]

[view.wireframe]
width = 2
"""

MATERIALS = """
[[material]]
label = "all"
base_colour = [0.1, 0.2, 0.3]
alpha = 0.9
alpha_cutoff = 0.5
metallic = 1
roughness = 0.25
emission = [4, 5, 6]
ior = 1.33
transmission = 0.5
base_colour_texture = "tiles.png"
metallic_roughness_texture = "tiles.png"
emission_texture = "tiles.png"
normal_texture = "tiles.png"
normal_scale = -0.5

[[material]]
label = "plain"
base_colour_texture = "tiles.png"
"""

A = '[[object]]\nname = "a"\n'
OAK = A + "[[material]]\nlabel = 'oak'\n"
GROUND = '[[object]]\nlabel = "ground"\nname = "a"\n[[object]]\nname = "b"\n'
BALL = '[[object]]\nshape = "icosphere"\ntriangles = 80\n'


@pytest.fixture
def write(tmp_path):
    def write_text(text: str):
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write_text


@pytest.fixture
def parse(write):
    return lambda text: parse_scene_file(write(text))


def test_every_key_reaches_its_object(parse, tmp_path):
    objects = parse(OBJECTS).objects
    assert list(objects) == ["ground", "bunny", "wheel", "galaxy", "atoms", "spheres"]
    ground, bunny, wheel, galaxy, atoms, pair = objects.values()
    assert dict(ground.source) == {"shape": "terrain", "triangles": 500, "seed": 7, "height": 1.5}
    assert ground.options == {"height": 1.5}
    assert (ground.colour, ground.mask, ground.repeat) == ((0.1, 0.2, 0.3), 2**32 - 1, None)
    assert (ground.transform == Transform((2, 1, 2), (0, 90, 0), (1, 2, 3)).matrix).all()
    assert dict(bunny.source) == {"name": "bunny"}
    assert (bunny.colour, bunny.mask) == (None, 5)
    assert (bunny.transform == [[1, 0, 0, 4], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]).all()
    assert bunny.repeat == Scatter("ground", 30, 4, (0.5, 2), "normal", turn=False)
    assert dict(wheel.source) == {"path": str(tmp_path / "parts/wheel.ply")}
    assert (wheel.repeat, wheel.count) == (Grid((3, 1, 2), (1, 0, 2.5)), 6)
    assert (galaxy.number, galaxy.seed, galaxy.options, galaxy.count) == (50, 3, {"arms": 4}, 1)
    assert dict(atoms.source) == {"spheres": str(tmp_path / "atoms.csv"), "radii": 0.5}
    assert dict(pair.source) == {"centres": ((0, 0, 0), (1, 2, 3)), "radii": (1, 0.5)}


def test_every_key_reaches_the_view(parse, tmp_path):
    expected = View(
        eye=(0, 0, 9),
        look_at=(0, 1, 0),
        up=(0, 1, 0.5),
        projection=Fisheye(220.5),
        cut=Cut.plane((0, 2, 0), (0, -1, 0)),
        width=64,
        shading="path",
        samples=3,
        surface=(1, 0, 0),
        background=((0, 0, 0), (1, 1, 1)),
        environment=tmp_path / "sky.exr",
        environment_rotation=45,
        light=Light(direction=(1, 1, 0), sky=(0.1, 0.2, 0.3)),
        wireframe=Wireframe(width=2),
    )
    assert parse(A + VIEW).view == expected


def test_what_is_left_out_has_its_default(parse):
    file = parse('[[object]]\nshape = "knot"\n')
    assert file.view == View()
    knot = file.objects["knot"]
    assert (knot.triangles, knot.seed, knot.options) == (100_000, 0, {})
    assert (knot.repeat, knot.colour, knot.material, knot.mask, knot.count) == (None, None, None, 2**32 - 1, 1)
    assert (knot.transform == np.eye(4)).all()
    assert parse(GROUND + 'repeat = {on = "ground", count = 2, scale = 3}').objects["b"].repeat.scale == (3, 3)


@pytest.mark.parametrize("mask", [0, 1, 2**32 - 1])
def test_a_mask_may_have_any_bits(parse, mask):
    assert parse(f"{A}mask = {mask}").objects["a"].mask == mask


def test_objects_without_a_label_are_numbered(parse):
    assert list(parse(3 * '[[object]]\nshape = "knot"\n').objects) == ["knot", "knot 2", "knot 3"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"no \[\[object\]\]: it needs a path"),
        ("[object", "not a TOML file"),
        ("lights = 1", "no key 'lights': there are object, material, view"),
        ('[object]\nname = "a"', r"write \[\[object\]\], not \[object\]"),
        ("[material]\nlabel = 'a'\n", r"write \[\[material\]\], not \[material\]"),
        ("object = 3", "object: expected array, got int"),
        ("object = [1]", r"object\[0\]: expected table, got int"),
        ("view = 3", "view: expected table, got int"),
        # Objects.
        ("[[object]]", "object 1: needs exactly one of path, name, shape, spheres, centres, not none of them"),
        (A + 'spheres = "b"', "object 1: needs exactly one of .*, not name and spheres"),
        ("[[object]]\nname = 7", "object 1: name: expected str, got int"),
        (A + '[[object]]\nname = "b"\ncolor = 1', "object 2: there is no key 'color': did you mean 'colour'?"),
        (A + "count = 1", "no key 'count'"),
        (A + 'label = " "', "object 1: the name of an object must be a text that is not empty"),
        (A + 'label = "x"\n[[object]]\nname = "b"\nlabel = "x"', "object 2: the scene has an object with the name 'x'"),
        (A + "colour = [1, 2]", "object 1: colour: expected array of length 3, got 2"),
        (A + "colour = [1, 2, nan]", "scene.toml: numbers must be finite, not nan"),
        (A + "colour = [1, 2, 1e400]", "scene.toml: numbers must be finite, not 1e400"),
        (A + "mask = -1", "object 1: mask: expected int >= 0"),
        (A + "mask = 4294967296", "mask: expected int <= 4294967295"),
        (A + "mask = 1.0", "mask: expected int, got float"),
        (A + "scale = [1, 0, 1]", "object 1: the transform's scale must be a finite number"),
        (A + "scale = 0", "scale must be a finite number other than 0"),
        (A + 'scale = "x"', r"object 1: scale: expected float \| array, got str"),
        (A + "scale = true", r"object 1: scale: expected float \| array, got bool"),
        (A + "matrix = [[1, 0], [0, 1]]", "matrix: expected array of length 4, got 2"),
        (A + "scale = 2\nmatrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "a matrix stands for"),
        (A + 'material = "oak"', r"object 1: there is no \[\[material\]\] with the label 'oak': there are none"),
        ("[[object]]\ncentres = [[1, 2, 3]]", "object 1: needs 'radii'"),
        ("[[object]]\ncentres = [[1, 2, 3]]\nradii = [1, 2]", "2 radii do not fit 1 centres"),
        ("[[object]]\ncentres = [[1, 2]]\nradii = 1", r"centres\[0\]: expected array of length 3, got 2"),
        ('[[object]]\ncentres = [[1, 2, 3]]\nradii = "x"', r"radii: expected float \| array, got str"),
        ('[[object]]\nspheres = "galaxy"\nradii = 1', "no key 'radii'"),
        ('[[object]]\nspheres = "a.csv"\nseed = 1', "no key 'seed'"),
        ('[[object]]\nspheres = "a.csv"\nradii = [1]', "radii: expected float, got array"),
        ('[[object]]\nspheres = "galaxy"\ncount = 9\ncolour = 1', "colour: expected array, got int"),
        ('[[object]]\nspheres = "galaxie"\ncount = 9', "there are no spheres 'galaxie': take one of galaxy, weekend"),
        ('[[object]]\nshape = "terrine"\ncolor = 1', "object 1: there is no shape 'terrine': take one of knot"),
        ('[[object]]\nshape = "terrain"\nturns = 2', "no key 'turns': there are label, .*, triangles, seed, height$"),
        ('[[object]]\nshape = "terrain"\nheight = "x"', r"height: expected int \| float, got str"),
        ('[[object]]\nshape = "terrain"\nseed = -1', "seed: expected int >= 0"),
        # Copies.
        (A + "repeat = 3", "object 1: repeat: expected a table"),
        (A + "[object.repeat]", "object 1: repeat: needs either 'grid' and 'spacing', or 'on' and 'count'"),
        (A + 'repeat = {grid = [1,1,1], on = "b"}', "needs either"),
        (A + "repeat = {grid = [1,1,1]}", "object 1: repeat: needs 'spacing'"),
        (A + "repeat = {grid = [1,1,1.5], spacing = [1,1,1]}", r"repeat: grid\[2\]: expected int, got float"),
        (A + "repeat = {grid = [1,0,1], spacing = [1,1,1]}", r"repeat: grid\[1\]: expected int >= 1"),
        (A + "repeat = {grid = [1,1,1], spacing = [1,1,1], step = 1}", "repeat: there is no key 'step'"),
        (A + 'repeat = {on = "b"}', "repeat: needs 'count'"),
        (A + 'repeat = {on = "b", count = 3}', "no object above it with the label 'b': there are none"),
        (GROUND + 'repeat = {on = "b", count = 3}', "object 2: there is no object above .* 'b': there are ground"),
        (GROUND + 'repeat = {on = "ground", count = 0}', "object 2: repeat: count: expected int >= 1"),
        (GROUND + 'repeat = {on = "ground", count = 3, seed = -1}', "seed: expected int >= 0"),
        (GROUND + 'repeat = {on = "ground", count = 3, scale = [1, 2, 3]}', "scale: expected array of length 2, got 3"),
        (GROUND + 'repeat = {on = "ground", count = 3, turn = 1}', "turn: expected bool, got int"),
        (GROUND + 'repeat = {on = "ground", count = 3, align = "x"}', "align must be one of up, normal, not 'x'"),
        (GROUND + 'repeat = {on = "ground", count = 1000000000}', "1,000,000,000 copies are too many"),
        (GROUND + 'repeat = {on = "ground", count = 1000000}', "1,000,001 copies are too many"),
        ('[[object]]\nspheres = "galaxy"\n' + A + 'repeat = {on = "galaxy", count = 1}', "must be a mesh"),
        (
            '[[object]]\nname = "g"\nrepeat = {grid = [2,1,1], spacing = [1,1,1]}\n'
            '[[object]]\nname = "a"\nrepeat = {on = "g", count = 1}',
            "must be a mesh that is placed once",
        ),
        # Materials.
        (A + "[[material]]\nmetallic = 1\n", "material 1: needs 'label'"),
        (A + "[[material]]\nlabel = ' '\n", "material 1: the name of a material must be a text that is not empty"),
        (OAK + "[[material]]\nlabel = 'oak'\n", "material 2: the scene has a material with the"),
        (OAK + "metalic = 1\n", "material 1: there is no key 'metalic': did you mean 'metallic"),
        (OAK + "roughness = 'x'\n", "material 1: roughness: expected float, got str"),
        (OAK + "roughness = 2\n", "material 1: the material's roughness must be a number from 0"),
        (OAK + "base_colour = [1, 1]\n", "base_colour: expected array of length 3, got 2"),
        (OAK + "base_colour_texture = 'b.png'\n", r"base_colour_texture: .*b\.png: no such file"),
        (OAK + "emission_texture = 'scene.toml'\n", "scene.toml: the file cannot be used as a"),
        (OAK + "emission_texture = '.'\n", "emission_texture: .*: the file cannot be read"),
        # The view: `test_view.py` has the limits of its settings.
        (A + "[view]\nsample = 1", "view: there is no setting 'sample': did you mean 'samples'?"),
        (A + "[view.light]\nup = 1", "view: light: there is no setting 'up'"),
        (A + "[view]\nwidth = 1.5", "view: width must be a whole number from 1 to 65,535"),
        (A + "[view]\nlook_at = [0, 0, 0]", "view: a camera with look_at needs an eye"),
        (A + "[view]\ncamera = 3", "view: camera must be a clbvh.Camera"),
        (A + "[view]\nenvironment = 'sky.png'", "view: the environment must be a file"),
        (A + "[view]\nsamples" + 3000 * ".a" + " = 1", "too many tables or lists within others"),
    ],
    ids=lambda value: value[-40:],
)  # fmt: skip
def test_what_a_scene_must_not_say_is_named_with_its_file(parse, text, message):
    with pytest.raises(SceneError, match=message) as caught:
        parse(text)
    assert "scene.toml: " in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_scene_file_is_named(tmp_path):
    with pytest.raises(SceneError, match=r"gone\.toml: no such file"):
        read_scene_file(tmp_path / "gone.toml")


def test_a_material_has_the_values_of_its_table(write, tmp_path):
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    imageio.imwrite(tmp_path / "tiles.png", pixels)
    copies = "repeat = {grid = [2, 1, 1], spacing = [3, 0, 0]}\n"
    scene, _ = read_scene_file(write(f'{MATERIALS}{BALL}material = "all"\n{BALL}material = "plain"\n{copies}{BALL}'))
    full, plain, copied, none = (instance.material for instance in scene.instances)
    numbers = ("name", "base_colour", "alpha", "alpha_cutoff", "metallic", "roughness", "emission", "ior")
    assert tuple(getattr(full, name) for name in numbers) == (
        "all", (0.1, 0.2, 0.3), 0.9, 0.5, 1.0, 0.25, (4.0, 5.0, 6.0), 1.33,
    )  # fmt: skip
    assert (full.transmission, full.normal_scale) == (0.5, -0.5)
    assert (full.base_colour_texture.pixels == pixels).all()
    # Colours are sRGB, numbers are not.
    assert [texture.is_srgb for texture in full.textures] == [True, False, True, False]
    # A file is read once.
    assert full.base_colour_texture is full.emission_texture is plain.base_colour_texture
    assert plain is copied
    assert none is None
    # Objects of one source share a geometry, whatever their materials.
    assert len(scene.geometries) == 1
    assert scene.geometries[0].shape.appearance is None
    with pytest.raises(SceneError, match=r"no \[\[material\]\] with the label 'oak': there are all, plain"):
        read_scene_file(write(f"{MATERIALS}{BALL}material = 'oak'\n"))


def test_a_material_shows_in_a_picture(write):
    text = "[[material]]\nlabel = 'red'\nbase_colour = [1, 0, 0]\nroughness = 1\nior = 1\n"
    picture = clbvh.render(*read_scene_file(write(f"{text}{BALL}material = 'red'\n")), width=9, height=9, samples=1)
    red, green, blue = picture.rgb[4, 4].astype(int)
    assert red > 2 * max(green, blue)


LENS = clbvh.Camera.from_intrinsics(
    [[500.1, 0.3, 320], [0, 510, 240], [0, 0, 1]], np.eye(4), (640, 480), distortion=(0.1, 0, 0, 0.01)
)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"samples": 3, "light": Light(direction=(1, 2, 3)), "ground": False, "up": "z"},
        {"eye": (1, 2, 3), "look_at": (0, 0, 0.1), "fov": 20.5, "background": (1, 0.5, 0)},
        {"wireframe": True, "projection": "orthographic:0.1", "side": "top"},
        {"wireframe": Wireframe(width=3), "cut": "z=33.3%"},
        {"cut": Cut.box((0, 0, 0), (1, 2, 0.1)), "frame": "all"},
        {"camera": LENS, "width": 320, "height": 240},
        {"camera": clbvh.Camera((0, 0, 5), (0, 0, 0.1), projection=Fisheye(220.1))},
        {"camera": clbvh.Camera((0, 0, 5), (0, 0, 0.1), aperture=0.1, focus_distance=3)},
        {"environment": np.full((2, 4, 3), 0.3), "environment_rotation": 0.1},
    ],
)
def test_a_saved_view_is_the_same_one(settings, tmp_path):
    view = View(**settings)
    save_scene(tmp_path / "a.scene", clbvh.Scene(clbvh.make_shape("cube", triangles=12)), view)
    scene, opened = clbvh.open_scene(tmp_path / "a.scene")
    assert opened == view
    assert [instance.name for instance in scene.instances] == ["cube"]


CAMERA = plain_view(View(camera=LENS))["camera"]


@pytest.mark.parametrize(
    "plain",
    [
        {"sample": 1},
        {"self": 1},
        {"samples": float("nan")},
        {"light": None},
        {"light": False},
        {"light": {"direction": [0, 0, float("inf")]}},
        {"wireframe": {"width": {}}},
        {"shading": []},
        {"background": {"a": 1}},
        {"projection": {"kind": "fisheye"}},
        {"cut": 3},
        {"cut": "z"},
        # A file that was sent must not have others read.
        {"environment": "sky.exr"},
        {"environment": {"height": 1, "width": -1, "pixels": "AACA"}},
        {"environment": [[[0, 0, -1]]]},
        {"environment": np.full((1, 1, 3), np.nan, np.float32)},
        {"environment": np.ones((1, 1, 4), np.float32)},
        {"environment": []},
        {"camera": 3},
        {"camera": None},
        {"camera": [["eye", 1]]},
        {"camera": {"eye": [0, 0, 1]}},
        {"camera": CAMERA | {"more": 1}},
        {"camera": CAMERA | {"eye": "abc"}},
        {"camera": CAMERA | {"fov": "a"}},
        {"camera": CAMERA | {"aperture": [1]}},
        {"camera": CAMERA | {"projection": [1]}},
        {"camera": CAMERA | {"lens": 7}},
        {"camera": CAMERA | {"lens": {"fx": 1}}},
        {"width": json.loads("[" * 900 + "]" * 900)},
    ],
    ids=lambda plain: str(plain)[:40],
)
def test_a_view_that_was_forged_is_refused(plain):
    with pytest.raises(SceneError, match="the view in the file cannot be used: "):
        view_of_plain(plain)
