"""Materials of instances: kept with them, checked, and shared by trees and tables."""

from __future__ import annotations

import copy
import json
import pickle

import numpy as np
import pytest

import clbvh
from clbvh.errors import SceneError
from clbvh.geometry.spheres import with_material
from clbvh.rendering.look_tables import Looks, make_look_tables
from clbvh.scene import serialize
from clbvh.scene.state import dress_shapes

GOLD = clbvh.Material("gold", metallic=1.0)
TILES = clbvh.Texture("tiles", np.arange(24, dtype=np.uint8).reshape(2, 3, 4))
TILED = clbvh.Material("tiled", base_colour_texture=TILES)
LOOKS = clbvh.Appearance(
    uvs=np.zeros((80, 3, 2)), colours=np.full((80, 3, 4), 9, np.uint8), materials=(clbvh.Material("own"),)
)
BALL = clbvh.make_shape("icosphere", triangles=80)
PAINTED = clbvh.Mesh.from_arrays(BALL.vertices, BALL.faces, name="painted", appearance=LOOKS)
DOTS = clbvh.Spheres(np.eye(3), 0.1, materials=(clbvh.Material("dot"),), material_ids=[0, 0, 0])


def place_all():
    scene = clbvh.Scene()
    painted, dots = scene.add(PAINTED), scene.add(DOTS)
    scene.place(painted)
    scene.place(painted, material=GOLD)
    scene.place_many(dots, np.tile(np.eye(4), (2, 1, 1)), material=TILED)
    scene.place(painted, material=clbvh.Material("gold", metallic=1.0), colour=(1, 0, 0))
    return scene


def names_of(scene):
    return [None if each.material is None else each.material.name for each in scene.instances]


NAMES = [None, "gold", "tiled", "tiled", "gold"]


def test_equal_materials_are_one():
    scene = place_all()
    assert names_of(scene) == NAMES
    state = scene.snapshot()
    assert state.materials == (GOLD, TILED)
    assert state.material_ids.tolist() == [-1, 0, 1, 1, 0]
    assert not state.material_ids.flags.writeable


def test_a_scene_within_a_scene_keeps_them():
    outer = clbvh.Scene()
    outer.add_parts(place_all())
    assert names_of(outer) == NAMES
    assert outer.snapshot().material_ids.tolist() == [-1, 0, 1, 1, 0]


@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, lambda scene: pickle.loads(pickle.dumps(scene))])
def test_copies_have_them_and_go_their_own_way(way):
    scene = place_all()
    other = way(scene)
    other.place(other.geometries[0], material=clbvh.Material("new"))
    assert names_of(other) == [*NAMES, "new"]
    assert names_of(scene) == NAMES
    assert len(scene.snapshot().materials) == 2
    assert [each.name for each in other.snapshot().materials] == ["gold", "tiled", "new"]


def test_a_saved_scene_has_them(tmp_path):
    place_all().save(tmp_path / "all.scene")
    loaded = clbvh.Scene.load(tmp_path / "all.scene")
    assert names_of(loaded) == NAMES
    state = loaded.snapshot()
    assert state.material_ids.tolist() == [-1, 0, 1, 1, 0]
    assert (state.materials[1].base_colour_texture.pixels == TILES.pixels).all()
    loaded.place(loaded.geometries[1], material=GOLD)
    assert loaded.snapshot().material_ids.tolist() == [-1, 0, 1, 1, 0, 0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda materials: materials[:1], "instance 2 has 1 among its material_ids, of 1"),
        (lambda materials: {}, "Expected `array`, got `object`"),
        (lambda materials: [materials[0], {"name": "a", "base_colour_texture": 5}], "damaged .*IndexError"),
        (lambda materials: [{}, materials[0]], "missing required field `name`"),
        (lambda materials: [5, materials[0]], "Expected `object`, got `int`"),
    ],
)
def test_a_forged_file_is_refused(tmp_path, monkeypatch, change, message):
    dumps = json.dumps

    def forge(text, **options):
        document = json.loads(dumps(text, **options))
        return dumps(document | {"materials": change(document["materials"])})

    monkeypatch.setattr(serialize.json, "dumps", forge)
    place_all().save(tmp_path / "all.scene")
    with pytest.raises(SceneError, match=message):
        clbvh.Scene.load(tmp_path / "all.scene")


@pytest.mark.parametrize("material", ["gold", 5, {}, clbvh.Material])
def test_a_wrong_material_is_refused(material):
    scene = clbvh.Scene()
    ball = scene.add(BALL)
    for place in (lambda: scene.place(ball, material=material), lambda: scene.place_many(ball, [], material=material)):
        with pytest.raises(SceneError, match="must be"):
            place()
    assert scene.is_empty


@pytest.mark.parametrize("shape", [PAINTED, BALL, DOTS], ids=lambda shape: shape.name)
def test_a_shape_in_a_material_shares_its_geometry(shape):
    dressed = with_material(shape, GOLD)
    assert dressed.appearance.materials == (GOLD,)
    assert dressed.appearance.colours is dressed.appearance.material_ids is None
    assert dressed.fingerprint == shape.fingerprint
    name = "vertices" if isinstance(shape, clbvh.Mesh) else "centres"
    assert getattr(dressed, name) is getattr(shape, name)
    assert shape.appearance is None or shape.appearance.materials != (GOLD,)


def test_a_geometry_has_one_shape_for_each_material():
    shapes, shape_ids = dress_shapes(place_all().snapshot())
    assert shape_ids.tolist() == [0, 2, 3, 3, 2]
    assert [shape.appearance.materials[0].name for shape in shapes] == ["own", "dot", "gold", "tiled"]
    assert shapes[2].appearance.uvs is shapes[0].appearance.uvs


def test_nothing_is_dressed_without_materials():
    state = clbvh.Scene(BALL).snapshot()
    shapes, shape_ids = dress_shapes(state)
    assert shapes is state.shapes
    assert shape_ids.tolist() == [0]


def test_tables_hold_the_corners_of_a_mesh_once():
    shapes, shape_ids = dress_shapes(place_all().snapshot())
    count = len(shape_ids)
    tables = make_look_tables(Looks(shapes, shape_ids, np.full((count, 3), np.nan)), np.zeros(count, bool), 40.0)
    assert len(tables["corner_normals"]) == 240
    assert len(tables["corner_uvs"]) == 480
    looks = tables["looks"]
    assert looks["first_normal"].tolist() == [0, 0, -1, -1, 0]
    assert looks["first_colour"].tolist() == [0, -1, -1, -1, -1]
    # That of shapes without one comes first: own, gold, tiled, tiled and gold, each material once.
    assert len(tables["materials"]) == 4
    assert looks["material_id"].min() == 1
    materials = tables["materials"][looks["material_id"]]
    assert materials["metallic"].tolist() == [0, 1, 0, 0, 1]
    assert materials["base_colour_texture"].tolist() == [-1, -1, 0, 0, -1]
