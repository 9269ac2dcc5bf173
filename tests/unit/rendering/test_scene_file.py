"""Scene files: their keys and scenes, what they must not say, saved views; scenes of mesh files; shipped scenes."""

import json

import imageio.v3 as imageio
import numpy as np
import pytest

import clbvh
from clbvh import (
    Cut,
    Fisheye,
    Light,
    Mesh,
    MeshError,
    Scene,
    SceneError,
    Spheres,
    Transform,
    View,
    Wireframe,
    load_mesh,
    open_scene,
)
from clbvh.files.open_scene import as_scene
from clbvh.files.scene_file import parse_scene_file, plain_view, read_scene_file, view_of_plain
from clbvh.scene.copies import Grid, Scatter
from clbvh.support.folders import find_folder
from clbvh.views.cameras.bounds import SceneBounds
from clbvh.views.view_finder import guess_up

from ..geometry.gltf_files import Gltf

OBJECTS = """
object = [
    {label = "ground", shape = "terrain", triangles = 500, seed = 7, height = 1.5, colour = [0.1, 0.2, 0.3],
     scale = [2, 1, 2], rotate = [0, 90, 0], translate = [1, 2, 3]},
    {name = "bunny", mask = 5, matrix = [[1, 0, 0, 4], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]],
     repeat = {on = "ground", count = 30, seed = 4, scale = [0.5, 2], align = "normal", turn = false}},
    {path = "parts/wheel.ply", repeat = {grid = [3, 1, 2], spacing = [1, 0, 2.5]}},
    {spheres = "galaxy", count = 50, seed = 3, arms = 4},
    {centres = [[0, 0, 0], [1, 2, 3]], radii = [1, 0.5]},
    {shape = "knot", repeat = {on = "ground", count = 2, scale = 3}},
    {shape = "knot"},
]
[view]
eye = [0, 0, 9]
look_at = [0, 1, 0]
up = [0, 1, 0.5]
projection = "fisheye:220.5"
cut = "y<2"
shading = "path"
background = [[0, 0, 0], [1, 1, 1]]
environment = "sky.exr"
light = {direction = [1, 1, 0]}
wireframe = {width = 2}
""".replace("\n     ", " ")  # a table is on one line

A = '[[object]]\nname = "a"\n'
OAK = A + "[[material]]\nlabel = 'oak'\n"
GROUND = '[[object]]\nlabel = "ground"\nname = "a"\n[[object]]\nname = "b"\n'
BALL = '[[object]]\nlabel = "ball"\nshape = "icosphere"\ntriangles = 80\n'
FLOOR = '[[object]]\nlabel = "floor"\nshape = "terrain"\ntriangles = 2\nheight = 0\n'
DOT = '[[object]]\nshape = "icosphere"\ntriangles = 20\n'


@pytest.fixture
def write(tmp_path):
    def write_text(text: str):
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write_text


@pytest.fixture
def read(write):
    return lambda text: read_scene_file(write(text))[0]


def test_every_key_reaches_its_object_and_the_view(write, tmp_path):
    file = parse_scene_file(write(OBJECTS))
    assert list(file.objects) == ["ground", "bunny", "wheel", "galaxy", "spheres", "knot", "knot 2"]
    ground, bunny, wheel, galaxy, pair, knot, plain = file.objects.values()
    assert dict(ground.source) == {"shape": "terrain", "triangles": 500, "seed": 7, "height": 1.5}
    assert (ground.colour, ground.mask, ground.repeat) == ((0.1, 0.2, 0.3), 2**32 - 1, None)
    assert (ground.transform == Transform((2, 1, 2), (0, 90, 0), (1, 2, 3)).matrix).all()
    assert (dict(bunny.source), bunny.colour, bunny.mask) == ({"name": "bunny"}, None, 5)
    assert (bunny.transform == [[1, 0, 0, 4], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]).all()
    assert bunny.repeat == Scatter("ground", 30, 4, (0.5, 2), "normal", turn=False)
    assert dict(wheel.source) == {"path": str(tmp_path / "parts/wheel.ply")}
    assert (wheel.repeat, wheel.count) == (Grid((3, 1, 2), (1, 0, 2.5)), 6)
    assert (galaxy.number, galaxy.seed, galaxy.options, galaxy.count) == (50, 3, {"arms": 4}, 1)
    assert dict(pair.source) == {"centres": ((0, 0, 0), (1, 2, 3)), "radii": (1, 0.5)}
    assert knot.repeat.scale == (3, 3)
    assert (plain.triangles, plain.seed, plain.options, plain.material) == (100_000, 0, {}, None)
    assert (plain.transform == np.eye(4)).all()
    assert file.view == View(
        eye=(0, 0, 9), look_at=(0, 1, 0), up=(0, 1, 0.5), projection=Fisheye(220.5), shading="path",
        cut=Cut.plane((0, 2, 0), (0, -1, 0)), background=((0, 0, 0), (1, 1, 1)),
        environment=tmp_path / "sky.exr", light=Light(direction=(1, 1, 0)), wireframe=Wireframe(width=2),
    )  # fmt: skip


def test_objects_become_geometries_and_instances(read, tmp_path):
    np.savez(tmp_path / "atoms.npz", centres=[[0, 0, 0], [1, 2, 3]], radii=[1, 0.5])
    (tmp_path / "points.csv").write_text("1,2,3\n")
    (tmp_path / "part.obj").write_text("o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\no b\nf 3 2 1\n")
    scene = read(
        BALL + "translate = [0, 5, 0]\nmask = 6\ncolour = [0.1, 0.2, 0.3]\n"
        '[[object]]\nspheres = "atoms.npz"\n[[object]]\nspheres = "points.csv"\nradii = 0.25\n'
        '[[object]]\ncentres = [[0, 0, 0], [4, 0, 0]]\nradii = 2\n[[object]]\npath = "part.obj"\n'
        + BALL.replace('"ball"', '"egg"') + "scale = [1, 2, 1]\nrepeat = {grid = [3, 1, 1], spacing = [5, 0, 0]}\n"
    )  # fmt: skip
    assert [geometry.name for geometry in scene.geometries] == ["ball", "atoms", "points", "spheres", "part"]
    # Objects of one source share a geometry; copies are named after their object.
    names = [*("ball", "atoms", "points", "spheres", "part"), *("egg", "egg 2", "egg 3")]
    assert [instance.name for instance in scene.instances] == names
    assert {instance.geometry.id for instance in scene.instances[5:]} == {0}
    assert [instance.transform[0, 3] for instance in scene.instances[5:]] == [-5, 0, 5]
    ball, atoms, points, spheres, part = (geometry.shape for geometry in scene.geometries)
    assert (type(ball), type(atoms), part.face_count) == (Mesh, Spheres, 2)
    assert [each.radii.tolist() for each in (atoms, points, spheres)] == [[1, 0.5], [0.25], [2, 2]]
    first, second = scene.instances[:2]
    assert (first.transform == Transform(translate=(0, 5, 0)).matrix).all()
    assert (first.mask, second.mask, first.colour, second.colour) == (6, 2**32 - 1, (0.1, 0.2, 0.3), None)


@pytest.mark.parametrize("mirror", [1, -1])
def test_copies_stand_on_the_surface_as_it_is_placed(read, mirror):
    text = f"{FLOOR}scale = [{mirror}, 1, 0.5]\ntranslate = [0, 7, 0]\n{DOT}"
    scene = read(text + 'repeat = {on = "floor", count = 200, align = "normal", turn = false}')
    transforms = np.array([instance.transform for instance in scene.instances[1:]])
    assert np.allclose(transforms[:, 1, 3], 7)
    assert np.abs(transforms[:, 0, 3]).max() == pytest.approx(5, abs=0.2)
    assert np.abs(transforms[:, 2, 3]).max() == pytest.approx(2.5, abs=0.1)
    # The normals of a mirrored floor still point up.
    assert np.allclose(transforms[:, :3, :3], np.eye(3))


def test_copies_are_upright_in_the_view_and_the_same_every_time(read):
    text = f'{FLOOR}rotate = [90, 0, 0]\n{DOT}repeat = {{on = "floor", count = 20}}\n'
    for up in ((0, 0, 1), (0, 1, 0)):
        scene = read(text + f"[view]\nup = {list(up)}")
        for instance in scene.instances[1:]:
            assert np.allclose(instance.transform[:3, :3] @ up, up)
            assert instance.transform[2, 3] == pytest.approx(0)
    assert scene.snapshot().transforms.tobytes() == read(text).snapshot().transforms.tobytes()


def test_objects_that_a_scale_of_0_hides_are_not_placed(read):
    on_floor = f'{DOT}repeat = {{on = "floor", count = 3}}\n'
    flat = "matrix = [[1,0,0,0],[0,1,0,0],[0,0,0,0],[0,0,0,1]]\n"
    dots = "[[object]]\ncentres = [[0, 0, 0]]\nradii = 1\nscale = [1, 1, 0]\n"
    for hidden in ("scale = 0\n", "scale = [1, 0, 1]\nrotate = [10, 20, 30]\n", flat):
        scene = read(BALL + hidden + FLOOR + DOT + dots + BALL.replace("ball", "row") + hidden + "[object.repeat]\n"
                     "grid = [2, 2, 2]\nspacing = [1, 1, 1]\n")  # fmt: skip
        assert [instance.name for instance in scene.instances] == ["floor", "icosphere"]
        # With them what stands on them; a scene without anything is one, too.
        scene = read(FLOOR + hidden + on_floor)
        with clbvh.Tracer(scene) as tracer:
            assert not tracer.any_hit(np.random.default_rng(0).normal(size=(100, 3)), [0, -1, 0]).any()
        assert clbvh.render(scene, width=8, height=8).hits.count == 0


PARSED = [
    ('[object]\nname = "a"', r"write \[\[object\]\], not \[object\]"),
    (A + '[[object]]\nname = "b"\ncolor = 1', "object 2: there is no key 'color': did you mean 'colour'?"),
    (A + "colour = [1, 2, 1e400]", "scene.toml: numbers must be finite, not 1e400"),
    (A + 'material = "oak"', r"object 1: there is no \[\[material\]\] with the label 'oak': there are none"),
    (A + "[object.repeat]", "object 1: repeat: needs either 'grid' and 'spacing', or 'on' and 'count'"),
    (GROUND + 'repeat = {on = "b", count = 3}', "object 2: there is no object above .* 'b': there are ground"),
    (GROUND + 'repeat = {on = "ground", count = 1000000}', "1,000,001 copies are too many"),
    (A + "repeat = {grid = [2,1,1], spacing = [1,1,1]}\n" + DOT + 'repeat = {on = "a", count = 1}', "placed once"),
    (OAK + "base_colour_texture = 'b.png'\n", r"base_colour_texture: .*b\.png: no such file"),
    (A + "[view]\nsample = 1", "view: there is no setting 'sample': did you mean 'samples'?"),
    (A + "[view]\nsamples" + 3000 * ".a" + " = 1", "too many tables or lists within others"),
]
LOADED = [
    (BALL.replace("80", "3"), r"scene\.toml: the object 'ball': .* at least 20 triangles"),
    (BALL + "matrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,1,1]]", "'ball': .*transform.* must be affine"),
    ('[[object]]\nspheres = "a.csv"', r"a\.csv: the file has no radii: give 'radii'"),
    ('[[object]]\npath = "line.obj"\n' + BALL + 'repeat = {on = "line", count = 3}', "on a surface without area"),
    (BALL + f'translate = [1.7e308, 0, 0]\nscale = 1e308\n{DOT}repeat = {{on = "ball", count = 3}}', "not finite"),
    (f"{FLOOR}{DOT}repeat = {{on = 'floor', count = 3}}\n[view]\nup = [0, 0, 0]", "up must not be zero"),
]


def test_what_a_scene_must_not_say_is_named_with_its_place(write, tmp_path):
    (tmp_path / "a.csv").write_text("1,2,3\n")
    (tmp_path / "line.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    for call, rows in ((parse_scene_file, PARSED), (read_scene_file, LOADED)):
        for text, words in rows:
            with pytest.raises((SceneError, MeshError), match=words) as caught:
                call(write(text))
            assert "scene.toml: " in str(caught.value)
            assert "\n" not in str(caught.value)


MATERIALS = """
material = [
    {label = "all", base_colour = [0.1, 0.2, 0.3], alpha = 0.9, alpha_cutoff = 0.5, metallic = 1, roughness = 0.25,
     emission = [4, 5, 6], ior = 1.33, transmission = 0.5, normal_scale = -0.5, base_colour_texture = "tiles.png",
     metallic_roughness_texture = "tiles.png", emission_texture = "tiles.png", normal_texture = "tiles.png"},
    {label = "plain", base_colour_texture = "tiles.png"},
]
""".replace("\n     ", " ")


def test_a_material_has_the_values_of_its_table(read, tmp_path):
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    imageio.imwrite(tmp_path / "tiles.png", pixels)
    scene = read(f'{MATERIALS}{DOT}material = "all"\n{DOT}material = "plain"\n{DOT}')
    full, plain, none = (instance.material for instance in scene.instances)
    tiles, same = clbvh.Texture("tiles.png", pixels), {"base_colour_texture", "emission_texture"}
    expected = {
        "name": "all", "base_colour": (0.1, 0.2, 0.3), "alpha": 0.9, "alpha_cutoff": 0.5, "metallic": 1.0,
        "roughness": 0.25, "emission": (4.0, 5.0, 6.0), "ior": 1.33, "transmission": 0.5, "normal_scale": -0.5,
    }  # fmt: skip
    assert {name: getattr(full, name) for name in expected} == expected
    assert (full.base_colour_texture.pixels == tiles.pixels).all()
    # Colours are sRGB, numbers are not; a file is read once.
    assert [texture.is_srgb for texture in full.textures] == [True, False, True, False]
    assert len({id(getattr(full, name)) for name in same} | {id(plain.base_colour_texture)}) == 1
    # Objects of one source share a geometry, whatever their materials.
    assert (none, len(scene.geometries)) == (None, 1)
    assert scene.geometries[0].shape.appearance is None


K = [[500.1, 0.3, 320], [0, 510, 240], [0, 0, 1]]
LENS = clbvh.Camera.from_intrinsics(K, np.eye(4), (640, 480), distortion=(0.1, 0, 0, 0.01))
PLACE = (0, 0, 5), (0, 0, 0.1)


def test_a_saved_view_is_the_same_one(tmp_path):
    rows = [
        {},
        {"samples": 3, "light": Light(direction=(1, 2, 3)), "ground": False, "up": "z"},
        {"wireframe": True, "projection": "orthographic:0.1", "side": "top", "cut": "z=33.3%"},
        {"camera": LENS, "width": 320, "height": 240},
        {"camera": clbvh.Camera(*PLACE, projection=Fisheye(220.1))},
        {"camera": clbvh.Camera(*PLACE, aperture=0.1, focus_distance=3)},
        {"environment": np.full((2, 4, 3), 0.3), "environment_rotation": 0.1},
    ]
    for settings in rows:
        view = View(**settings)
        clbvh.save_scene(tmp_path / "a.scene", clbvh.Scene(clbvh.make_shape("cube", triangles=12)), view)
        scene, opened = clbvh.open_scene(tmp_path / "a.scene")
        assert opened == view
        assert [instance.name for instance in scene.instances] == ["cube"]


def test_a_view_that_was_forged_is_refused():
    camera = plain_view(View(camera=LENS))["camera"]
    cameras = [{"more": 1}, {"eye": "abc"}, {"aperture": [1]}, {"projection": [1]}, {"lens": {"fx": 1}}]
    # A file that was sent must not have others read.
    pixels = ["sky.exr", {"height": 1, "width": -1, "pixels": "AACA"}, np.full((1, 1, 3), np.nan, np.float32), []]
    rows = [
        {"sample": 1}, {"self": 1}, {"samples": float("nan")}, {"light": None}, {"wireframe": {"width": {}}},
        {"light": {"direction": [0, 0, float("inf")]}}, {"shading": []}, {"projection": {"kind": "fisheye"}},
        {"cut": 3}, {"camera": 3}, {"camera": [["eye", 1]]}, {"camera": {"eye": [0, 0, 1]}},
        {"width": json.loads("[" * 900 + "]" * 900)}, *({"environment": each} for each in pixels),
        *({"camera": camera | changes} for changes in cameras),
    ]  # fmt: skip
    for plain in rows:
        with pytest.raises(SceneError, match="the view in the file cannot be used: "):
            pytest.fail(str(view_of_plain(plain)))


def test_nodes_that_multiply_the_triangles_are_instances(tmp_path):
    for copies, instances in ((1, ["glb"]), (2, ["glb"]), (3, ["n", "n 2", "n 3"])):
        gltf = Gltf()
        # A plate that would lie on the ground if z were up; the rule of glTF is y.
        corners = gltf.add_accessor([[0, 0, 0], [5, 0, 0], [0, 5, 0.1]], "f4")
        mesh = gltf.add_mesh({"attributes": {"POSITION": corners}})
        for number in range(copies):
            gltf.add_node(mesh=mesh, name="n", translation=[5 * number, 0, 0])
        path = gltf.write_glb(tmp_path / "glb.glb")
        for scene in (Scene(path), open_scene(path)[0], as_scene([path, path])[0]):
            assert [instance.name for instance in scene.instances][: len(instances)] == instances
            state = scene.snapshot()
            assert guess_up(SceneBounds(state.shapes, state.geometry_ids, state.transforms)).vector == (0, 1, 0)
        assert [part.name for part in load_mesh(path).parts] == (["n"] * copies if copies > 1 else [])


SHIPPED = ["bunny", "cornell", "demo", "dragon", "drill", "galaxy", "hall", "knot", "meadow", "palace", "still-life"]


def test_the_shipped_scenes_are_the_promised_ones_and_say_what_is_up(tmp_path, monkeypatch):
    paths = sorted(find_folder("scenes").glob("*.toml"))
    assert [path.stem for path in paths] == [*SHIPPED, "terrain", "weekend"]
    assert all(parse_scene_file(path).view.up != "auto" for path in paths)
    with pytest.raises(SceneError, match=r"bunni: no such file, and no shipped scene: these are bunny, cornell, demo"):
        open_scene("bunni")
    # A file comes before a shipped scene of its name.
    monkeypatch.chdir(tmp_path)
    (tmp_path / "knot").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert open_scene("knot")[0].geometries[0].shape.face_count == 1
