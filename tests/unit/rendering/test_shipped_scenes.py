"""The shipped scenes: which there are, and what they hold."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.errors import SceneError
from clbvh.geometry import Mesh, Spheres
from clbvh.rendering.open_scene import open_scene
from clbvh.rendering.scene_file import parse_scene_file
from clbvh.support.folders import find_folder

SHIPPED = (
    "bunny", "cornell", "demo", "dragon", "drill", "galaxy", "hall", "knot", "meadow", "palace", "still-life",
    "terrain", "weekend",
)  # fmt: skip


def test_a_misspelt_scene_is_told_the_names():
    with pytest.raises(SceneError, match=r"bunni: no such file, and no shipped scene: these are bunny, cornell, demo"):
        open_scene("bunni")


def test_the_shipped_scenes_are_the_promised_ones():
    assert sorted(path.stem for path in find_folder("scenes").glob("*.toml")) == sorted(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scene_has_objects_and_says_what_is_up(name):
    file = parse_scene_file(find_folder("scenes") / f"{name}.toml")
    assert file.objects
    assert file.view.up != "auto"


def test_a_file_comes_before_a_shipped_scene_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "knot").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (instance,) = open_scene("knot")[0].instances
    assert instance.geometry.shape.face_count == 1


def test_the_meadow_has_10_000_instances_on_hills():
    scene, _ = open_scene("meadow")
    assert len(scene.instances) == 10_001
    assert len(scene.geometries) == 4
    hills, others = scene.geometries[0].shape, scene.instances[1:]
    centres = np.array([instance.transform[:3, 3] for instance in others[::100]])
    # The grid of the terrain has a vertex within half a cell of each.
    nearest = [np.abs(hills.vertices[:, [0, 2]] - centre[[0, 2]]).max(axis=1).argmin() for centre in centres]
    assert np.abs(hills.vertices[nearest, 1] - centres[:, 1]).max() < 0.15


def test_the_galaxy_has_200_000_spheres():
    assert sum(geometry.shape.prim_count for geometry in open_scene("galaxy")[0].geometries) == 200_000


def test_the_still_life_has_meshes_and_spheres():
    scene, _ = open_scene("still-life")
    assert {type(geometry.shape) for geometry in scene.geometries} == {Mesh, Spheres}


@pytest.mark.parametrize("name", ["meadow", "galaxy", "hall", "still-life", "cornell", "weekend"])
def test_a_shipped_scene_of_objects_is_the_same_every_time(name):
    first, second = (open_scene(name)[0].snapshot() for _ in range(2))
    assert first.transforms.tobytes() == second.transforms.tobytes()
    assert [shape.fingerprint for shape in first.shapes] == [shape.fingerprint for shape in second.shapes]


def test_the_weekend_has_spheres_of_chalk_metal_and_glass():
    scene, view = open_scene("weekend")
    (geometry,) = scene.geometries
    assert geometry.shape.prim_count == 480
    materials = [geometry.shape.appearance.materials[number] for number in geometry.shape.appearance.material_ids]
    glass, metal = (sum(bool(getattr(each, name)) for each in materials) for name in ("transmission", "metallic"))
    assert (10 < glass < 50, 40 < metal < 110, 330 < 480 - glass - metal < 420) == (True, True, True)
    assert view.aperture > 0
    assert view.light.colour == (0, 0, 0)


def test_the_cornell_box_has_one_lamp():
    scene, _ = open_scene("cornell")
    lamps = [each.name for each in scene.instances if any(each.material.emission)]
    assert lamps == ["lamp"]
    assert {geometry.shape.name for geometry in scene.geometries} == {"square", "cube"}


def test_the_knot_has_the_size_of_the_dragon():
    assert open_scene("knot")[0].geometries[0].shape.face_count == 871_200
