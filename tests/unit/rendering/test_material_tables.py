"""The `[[material]]` tables of scene files: their keys, textures and labels, and what is refused."""

from __future__ import annotations

import imageio.v3 as imageio
import numpy as np
import pytest

import clbvh
from clbvh.errors import SceneError
from clbvh.rendering.scene_file import read_scene

BALL = '[[object]]\nshape = "icosphere"\ntriangles = 80\n'
PIXELS = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)

WHOLE = """
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


@pytest.fixture
def write(tmp_path):
    imageio.imwrite(tmp_path / "tiles.png", PIXELS)

    def write_text(text):
        path = tmp_path / "some.toml"
        path.write_text(text)
        return path

    return write_text


def test_a_material_has_the_values_of_its_table(write):
    scene = read_scene(write(f'{WHOLE}{BALL}material = "all"\n{BALL}material = "plain"\n{BALL}'))
    full, plain, none = (instance.material for instance in scene.instances)
    numbers = ("name", "base_colour", "alpha", "alpha_cutoff", "metallic", "roughness", "emission", "ior")
    assert tuple(getattr(full, name) for name in numbers) == (
        "all", (0.1, 0.2, 0.3), 0.9, 0.5, 1.0, 0.25, (4.0, 5.0, 6.0), 1.33,
    )  # fmt: skip
    assert full.transmission == 0.5
    assert full.normal_scale == -0.5
    assert (full.base_colour_texture.pixels == PIXELS).all()
    # Colours are sRGB, numbers are not.
    assert [texture.is_srgb for texture in full.textures] == [True, False, True, False]
    # A file is read once.
    assert full.base_colour_texture is full.emission_texture is plain.base_colour_texture
    assert none is None


def test_objects_of_one_source_share_a_geometry_whatever_their_materials(write):
    scene = read_scene(write(f'{WHOLE}{BALL}material = "all"\n{BALL}material = "plain"\n{BALL}'))
    assert len(scene.geometries) == 1
    assert scene.geometries[0].shape.appearance is None


def test_copies_have_the_material_of_their_object(write):
    text = f'{WHOLE}{BALL}material = "plain"\nrepeat = {{grid = [3, 1, 1], spacing = [3, 0, 0]}}\n'
    assert [each.material.name for each in read_scene(write(text)).instances] == ["plain"] * 3


def test_the_only_mesh_has_a_material(write):
    scene = read_scene(write(f'{WHOLE}[mesh]\nshape = "icosphere"\ntriangles = 80\nmaterial = "plain"\n'))
    assert scene.mesh.load().appearance.materials == (scene.mesh.material,)
    assert scene.mesh.material.name == "plain"
    assert scene.is_one_mesh


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[material]\nlabel = 'a'\n", r"materials are tables of their own: write \[\[material\]\]"),
        ("[[material]]\nmetallic = 1\n", r"\[material 1\] needs a label"),
        ("[[material]]\nlabel = ' '\n", r"\[material 1\] needs a label"),
        ("[[material]]\nlabel = 'a'\n[[material]]\nlabel = 'a'\n", r"\[material 2\] has the label 'a' of another"),
        ("[[material]]\nlabel = 'a'\ncolour = [1, 1, 1]\n", r"\[material 1\] has an unknown key 'colour'; known are"),
        ("[[material]]\nlabel = 'a'\nroughness = 'x'\n", r"\[material 1\] roughness must be a finite number"),
        ("[[material]]\nlabel = 'a'\nroughness = nan\n", r"\[material 1\] roughness must be a finite number"),
        ("[[material]]\nlabel = 'a'\nroughness = 2\n", r"\[material 1\] 'a': the material's roughness must be"),
        ("[[material]]\nlabel = 'a'\nbase_colour = [1, 1]\n", r"base_colour must be three finite numbers"),
        ("[[material]]\nlabel = 'a'\nbase_colour_texture = 'b.png'\n", r"base_colour_texture: .*b\.png: no such file"),
        ("[[material]]\nlabel = 'a'\nemission_texture = 'some.toml'\n", r"some\.toml: the file cannot be used as a t"),
        ("[[material]]\nlabel = 'a'\nemission_texture = '.'\n", r"emission_texture: "),
    ],
)
def test_what_is_no_material_is_refused(write, text, message):
    with pytest.raises(SceneError, match=message):
        read_scene(write(text + BALL))


@pytest.mark.parametrize("where", [BALL, "[mesh]\nshape = 'icosphere'\n"])
def test_an_unknown_material_is_refused_with_the_known_ones(write, where):
    with pytest.raises(SceneError, match=r"has the material 'oak', but no .* has this label: there are 'all', 'plain'"):
        read_scene(write(f"{WHOLE}{where}material = 'oak'\n"))
    with pytest.raises(SceneError, match="there are none"):
        read_scene(write(f"{where}material = 'oak'\n"))


def test_a_material_shows_in_a_picture(write):
    text = "[[material]]\nlabel = 'red'\nbase_colour = [1, 0, 0]\nroughness = 1\nior = 1\n"
    for where in (BALL, "[mesh]\nshape = 'icosphere'\ntriangles = 80\n"):
        scene = read_scene(write(f"{text}{where}material = 'red'\n[image]\nwidth = 9\nheight = 9\nsamples = 1\n"))
        red, green, blue = clbvh.render(scene).rgb[4, 4].astype(int)
        assert red > 2 * max(green, blue), where
