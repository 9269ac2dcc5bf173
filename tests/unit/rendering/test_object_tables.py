"""The `[[object]]` tables: their keys, and the messages about invalid ones."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from clbvh.errors import SceneError
from clbvh.rendering.object_tables import read_objects
from clbvh.rendering.objects import Grid, Scatter, SpheresSource
from clbvh.rendering.scene import MeshSource
from clbvh.rendering.sources import Transform


def read(text: str):
    return read_objects(tomllib.loads(text)["object"], Path("folder"))


WHOLE = """
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


def test_every_key_reaches_its_object():
    ground, bunny, wheel, galaxy, atoms, pair = read(WHOLE)
    assert ground.source == MeshSource(shape="terrain", triangles=500, seed=7, options={"height": 1.5})
    assert (ground.label, ground.colour, ground.mask, ground.repeat) == ("ground", (0.1, 0.2, 0.3), 2**32 - 1, None)
    assert (ground.matrix == Transform((2, 1, 2), (0, 90, 0), (1, 2, 3)).matrix).all()
    assert bunny.source == MeshSource(name="bunny")
    assert (bunny.label, bunny.colour, bunny.mask) == ("bunny", None, 5)
    assert (bunny.matrix == [[1, 0, 0, 4], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]).all()
    assert bunny.repeat == Scatter("ground", 30, 4, (0.5, 2), "normal", turn=False)
    assert (wheel.label, wheel.source) == ("wheel", MeshSource(path="folder/parts/wheel.ply"))
    assert (wheel.repeat, wheel.count) == (Grid((3, 1, 2), (1, 0, 2.5)), 6)
    assert galaxy.source == SpheresSource(generator="galaxy", count=50, seed=3, options={"arms": 4})
    assert atoms.source == SpheresSource(path="folder/atoms.csv", radii=0.5)
    assert pair.source == SpheresSource(centres=((0, 0, 0), (1, 2, 3)), radii=(1, 0.5))
    assert [found.label for found in (galaxy, atoms, pair)] == ["galaxy", "atoms", "spheres"]


def test_what_is_left_out_has_its_default():
    (found,) = read('[[object]]\nshape = "knot"')
    assert (found.label, found.source) == ("knot", MeshSource(shape="knot"))
    assert (found.repeat, found.colour, found.mask, found.count) == (None, None, 2**32 - 1, 1)
    assert (found.matrix == np.eye(4)).all()
    assert read(GROUND + '[object.repeat]\non = "ground"\ncount = 2\nscale = 3')[1].repeat.scale == (3, 3)


@pytest.mark.parametrize("mask", [0, 1, 2**32 - 1])
def test_a_mask_may_have_any_bits(mask):
    assert read(f'[[object]]\nshape = "knot"\nmask = {mask}')[0].mask == mask


def test_objects_without_a_label_are_numbered():
    text = '[[object]]\nshape = "knot"\n'
    assert [found.label for found in read(3 * text)] == ["knot", "knot 2", "knot 3"]


GROUND = '[[object]]\nlabel = "ground"\nname = "a"\n[[object]]\nname = "b"\n'
A = '[[object]]\nname = "a"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[object]\nname = "a"', r"write \[\[object\]\]"),
        ("object = []", r"write \[\[object\]\]"),
        ("object = [1]", r"write \[\[object\]\]"),
        ("[[object]]", r"\[object 1\] needs exactly one of path, name, shape, spheres, centres, not none"),
        (A + 'spheres = "b"', "exactly one of .*, not name and spheres"),
        (A + '[[object]]\nname = "b"\ncolor = 1', r"\[object 2\] has an unknown key 'color'; known"),
        (A + 'count = 1', "unknown key 'count'"),
        (A + 'label = " "', r"\[object 1\] the label must not be empty"),
        (A + 'colour = [1, 2]', r"\[object 1\] colour must be three finite numbers, not \[1, 2\]"),
        (A + 'mask = -1', r"\[object 1\] the mask must be 32 bits, 0 to 4294967295, not -1"),
        (A + 'mask = 4294967296', "the mask must be 32 bits"),
        (A + 'scale = [1, 0, 1]', r"\[object 1\] the transform's scale must be a finite number"),
        (A + 'scale = 0', "scale must be a finite number other than 0"),
        (A + 'scale = "x"', "scale must be a finite number, or three, not 'x'"),
        (A + 'matrix = [[1, 0], [0, 1]]', "matrix must be 4 rows of 4 finite numbers"),
        (A + 'scale = 1\nmatrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]', "a matrix stands for"),
        (A + 'repeat = 3', "repeat must be a table"),
        (A + '[object.repeat]', r"\[object 1.repeat\] needs either 'grid' and 'spacing', or 'on'"),
        (A + 'repeat = {grid = [1,1,1], on = "b"}', "needs either"),
        (A + 'repeat = {grid = [1,1,1]}', "needs 'spacing' beside 'grid'"),
        (A + 'repeat = {grid = [1,1,1.5], spacing = [1,1,1]}', "grid must be 3 whole numbers"),
        (A + 'repeat = {grid = [1,0,1], spacing = [1,1,1]}', r"\[object 1\] a grid needs counts"),
        (A + 'repeat = {grid = [1,1,1], spacing = [1,1,1], step = 1}', "unknown key 'step'"),
        (A + 'repeat = {on = "b"}', "needs 'count' beside 'on'"),
        (A + 'repeat = {on = "b", count = 3}', "no object above it has this label: there are none"),
        (GROUND + 'repeat = {on = "b", count = 3}', "scattered on 'b', but no object above .*: there are 'ground'"),
        (GROUND + 'repeat = {on = "ground", count = 3, scale = [1, 2, 3]}', "the smallest and the largest, not 3"),
        (GROUND + 'repeat = {on = "ground", count = 3, turn = 1}', "turn must be true or false, not 1"),
        (GROUND + 'repeat = {on = "ground", count = 3, align = "x"}', "align must be one of up, normal, not 'x'"),
        (GROUND + 'repeat = {on = "ground", count = 1000000000}', "1,000,000,000 copies are too many"),
        (GROUND + 'repeat = {on = "ground", count = 1000000}', "1,000,001 copies are too many"),
        ('[[object]]\nspheres = "galaxy"\n' + A + 'repeat = {on = "galaxy", count = 1}', "must be a mesh"),
        (
            '[[object]]\nname = "g"\nrepeat = {grid = [2,1,1], spacing = [1,1,1]}\n'
            '[[object]]\nname = "a"\nrepeat = {on = "g", count = 1}',
            "must be a mesh that is placed once",
        ),
        (A + 'label = "x"\n[[object]]\nname = "b"\nlabel = "x"', "label 'x' of another object"),
        ("[[object]]\ncentres = [[1, 2, 3]]", "centres need radii"),
        ("[[object]]\ncentres = [[1, 2, 3]]\nradii = [1, 2]", "2 radii do not fit 1 centres"),
        ("[[object]]\ncentres = [[1, 2]]\nradii = 1", "centres must be a list of rows of 3 finite numbers"),
        ('[[object]]\ncentres = [[1, 2, 3]]\nradii = "x"', "radii must be a finite number, or a list of them"),
        ('[[object]]\nspheres = "galaxy"\nradii = 1', "'galaxy' have radii of their own"),
        ('[[object]]\nspheres = "a.csv"\nseed = 1', "unknown key 'seed'"),
        (
            '[[object]]\nshape = "terrain"\ntriangles = 9\ncolor = [1, 0, 0]',
            r"\[object 1\] has an unknown key 'color'; known are label, colour, .*, triangles, seed, height$",
        ),
        ('[[object]]\nshape = "terrain"\ntriangles = 9\nturns = 2', "unknown key 'turns'; known"),
        ('[[object]]\nshape = "terrain"\ntriangles = 9\nheight = "x"', "height must be a finite number, not 'x'"),
        ('[[object]]\nshape = "terrine"\ntriangles = 9\ncolor = 1', "there is no shape 'terrine': take one of knot"),
        ('[[object]]\nspheres = "galaxy"\ncount = 9\ncolor = [1, 0, 0]', "unknown key 'color'; known are .*, arms"),
        ('[[object]]\nspheres = "galaxie"\ncount = 9', "there are no spheres 'galaxie': take one of galaxy, weekend"),
    ],
)  # fmt: skip
def test_what_an_object_must_not_say_is_named(text, message):
    with pytest.raises(SceneError, match=message) as caught:
        read(text)
    assert "\n" not in str(caught.value)
