"""Scenes in files: a saved scene comes back with its looks, and every other content is refused."""

import copy
import dataclasses
import json
import re
import zipfile

import numpy as np
import pytest

import clbvh
from clbvh import ConfigError, SceneError

from .test_scene import same

CHECKER = clbvh.Texture(
    "checker", np.arange(24, dtype=np.uint8).reshape(3, 2, 4), is_srgb=False, wrap=("clamp", "mirror"), filter="nearest"
)
PLAIN = clbvh.Texture("plain", np.full((1, 5), 7, np.uint8))
TILES = clbvh.Material("tiles", (0.1, 0.2, 0.3), alpha_cutoff=0.5, roughness=0, base_colour_texture=CHECKER)
LAMP = clbvh.Material(
    "lamp", emission=(5, 6, 7), ior=1.33, alpha_cutoff=np.inf, emission_texture=CHECKER,
    metallic_roughness_texture=PLAIN,
)  # fmt: skip
LOOKS = clbvh.Appearance(
    normals=np.tile(np.float32([0.6, 0, 0.8]), (3, 3, 1)),
    uvs=np.arange(18).reshape(3, 3, 2),
    colours=np.arange(36, dtype=np.uint8).reshape(3, 3, 4),
    materials=(TILES, LAMP),
    material_ids=[0, 1, 0],
)
MESH = clbvh.Mesh.from_arrays(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
    [[0, 1, 2], [2, 1, 0], [1, 2, 0]],
    name="corner",
    appearance=LOOKS,
    parts=[("front", 0, 1), ("back", 1, 3)],
)
DOTS = clbvh.Spheres(
    [[0, 0, 0], [5, 0, 0], [0, 1e-30, 7]], [1, 2, 1e-3], name="dots", materials=(LAMP,),
    colours=np.arange(12, dtype=np.uint8).reshape(3, 4),
)  # fmt: skip


def make_scene():
    scene = clbvh.Scene(MESH)
    dots = scene.add(DOTS, name="Sterne ★")
    scene.place(dots, clbvh.Transform(scale=3, rotate=(1, 2, 3), translate=(1e7, 0, -0.0)), mask=5, colour=(1, 0, 0.5))
    scene.place(dots, np.diag([-1e-30, 1, 1, 1]), material=clbvh.Material("own", base_colour_texture=CHECKER))
    return scene


@pytest.fixture
def path(tmp_path):
    make_scene().save(tmp_path / "a.scene")
    return tmp_path / "a.scene"


def split(path):
    """Return the text of a file, and its arrays by their names."""
    with np.load(path) as archive:
        arrays = dict(archive)
    return json.loads(arrays.pop("clbvh_scene").tobytes()), arrays


def forge(path, text, arrays, save=np.savez):
    """Write a file whose checksums are right, whatever it holds."""
    content = text if isinstance(text, bytes) else json.dumps(text).encode()
    with path.open("wb") as file:
        save(file, clbvh_scene=np.frombuffer(content, np.uint8), **arrays)


def refused(path):
    """Return the one sentence with which a file is refused."""
    with pytest.raises(SceneError) as caught:
        clbvh.Scene.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message.removeprefix(str(path))


def test_a_saved_scene_comes_back_and_is_saved_as_the_same_file(path, tmp_path):
    loaded = clbvh.Scene.load(str(path))
    same(make_scene(), loaded)
    assert [instance.colour for instance in loaded.instances] == [None, (1, 0, 0.5), None]
    loaded.save(tmp_path / "b.scene")
    assert (tmp_path / "b.scene").read_bytes() == path.read_bytes()
    assert loaded.place(loaded.geometries[1]).name == "Sterne ★ 3"
    clbvh.Scene().save(path)
    assert clbvh.Scene.load(path).is_empty


def test_looks_come_back_and_share_their_textures(path):
    scene = clbvh.Scene.load(path)
    mesh, dots = (geometry.shape for geometry in scene.geometries)
    for name in ("normals", "uvs", "colours", "material_ids"):
        values = getattr(mesh.appearance, name)
        np.testing.assert_array_equal(values, getattr(LOOKS, name))
        assert values.dtype == getattr(LOOKS, name).dtype
    np.testing.assert_array_equal(dots.appearance.colours, DOTS.appearance.colours)
    assert mesh.parts == MESH.parts
    tiles, lamp = mesh.appearance.materials
    checker, plain = tiles.base_colour_texture, lamp.metallic_roughness_texture
    for texture, expected in ((checker, CHECKER), (plain, PLAIN)):
        np.testing.assert_array_equal(texture.pixels, expected.pixels)
        for name in ("name", "is_srgb", "wrap", "filter"):
            assert getattr(texture, name) == getattr(expected, name)
    assert tiles == dataclasses.replace(TILES, base_colour_texture=checker)
    assert lamp == dataclasses.replace(LAMP, emission_texture=checker, metallic_roughness_texture=plain)
    assert dots.appearance.materials == (lamp,)
    assert scene.instances[2].material.base_colour_texture is checker


def test_odd_names_come_back(tmp_path):
    scene = clbvh.Scene()
    wanted = ['"', "\\", "a\n", "\0", "ß \U0001f600", "a" * 5000, np.str_("n")]
    mesh = clbvh.Mesh.from_arrays(MESH.vertices, MESH.faces, name="\ud800")
    for name in wanted:
        scene.place(scene.add(mesh, name=name), name=name)
    scene.save(tmp_path / "a.scene")
    loaded = clbvh.Scene.load(tmp_path / "a.scene")
    assert [geometry.name for geometry in loaded.geometries] == wanted
    assert loaded.geometries[0].shape.name == "\ud800"


def test_every_changed_byte_is_noticed_or_changes_nothing(path):
    content, refusals = path.read_bytes(), 0
    for at in range(0, len(content), 11):
        damaged = bytearray(content)
        damaged[at] ^= 1 << at % 8
        path.write_bytes(damaged)
        try:
            same(make_scene(), clbvh.Scene.load(path))
        except SceneError as error:
            refusals += str(error).startswith(f"{path}: ")
    assert refusals > len(content) / 22


def test_shapes_that_lie_allocate_nothing(path):
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    whole = members["transforms.npy"]
    for shape in ("(1,)", "(2, 4, 4)", "(4, 4, 4)", "(99999999999999, 4, 4)", "(-3, 4, 4)"):
        old, new = (f"{each}, }}".ljust(30).encode() for each in ("(3, 4, 4)", shape))
        assert old in whole
        with zipfile.ZipFile(path, "w") as archive:
            for name, member in members.items():
                archive.writestr(name, member.replace(old, new) if name == "transforms.npy" else member)
        assert "save the scene again" in refused(path), shape


def test_nothing_in_a_file_expands_or_is_unpickled(path):
    text, arrays = split(path)
    forge(path, text, arrays, save=np.savez_compressed)
    assert "packed, or larger than the file" in refused(path)
    forge(path, text, arrays)
    same(make_scene(), clbvh.Scene.load(path))
    with zipfile.ZipFile(path, "a") as archive:
        for number in range(50):
            twice = copy.copy(archive.getinfo("transforms.npy"))
            twice.filename = f"settings_{number}.npy"
            archive.filelist.append(twice)
        archive.comment = b"changed"  # so that the list of members is written
    assert "packed, or larger than the file" in refused(path)
    forge(path, text, arrays | {"masks": np.array([5, None, 7])})
    assert "masks must be numbers, not object" in refused(path)


def test_other_files_and_paths_are_refused(path, tmp_path):
    for other in (b"", b"ply\n", bytes(1000), b"\x8bBVH\r\n\x1a\n" + bytes(200)):
        path.write_bytes(other)
        assert "not a saved scene" in refused(path)
    assert "no such file" in refused(tmp_path / "gone.scene")
    for target, message in ((5, "not the path"), (tmp_path / "gone" / "a", "does not exist"), (tmp_path, "a folder")):
        with pytest.raises(ConfigError, match=message):
            make_scene().save(target)
        with pytest.raises(SceneError):
            clbvh.Scene.load(target)


def test_a_forged_text_is_refused_by_its_fault(path):
    document, arrays = split(path)
    for keys, value, message in (
        (["format"], 2, "has the format 2, and this version of clbvh reads format 1"),
        (["geometries"], 5, r"Expected `array`, got `int` - at `\$.geometries`"),
        (["geometries", 0, "kind"], "teapot", "Invalid enum value 'teapot'"),
        (["geometries", 0, "name"], "Sterne ★", "geometry with the name 'Sterne ★' already"),
        (["geometries", 0, "spin"], 5, "unknown field `spin`"),
        (["geometries", 0, "parts"], [["a", 0, 10**300]], "the part 'a' has the faces"),
        (["geometries", 0, "materials", 0, "ior"], 10**400, "out of range"),
        (["geometries", 0, "materials", 0, "ior"], 0.5, "ior must be a number from 1 to 100"),
        (["geometries", 0, "materials", 0, "base_colour_texture"], -1, "Expected `int` >= 0"),
        (["textures", 0, "wrap"], ["spiral", "clamp"], "two of repeat"),
        (["textures", 0, "filter"], "cubic", "linear or nearest"),
        (["materials"], [], "instance 2 has 0 among its material_ids, of 0"),
        (["instance_names"], [], "does not fit 0 instances"),
    ):
        text = copy.deepcopy(document)
        table = text
        for key in keys[:-1]:
            table = table[key]
        table[keys[-1]] = value
        forge(path, text, arrays)
        assert re.search(message, refused(path)), keys
    for text in (b"", b"[" * 100_000, b'{"format": 1', b"\xff" * 8, b"9" * 8000, b"null", b"[]"):
        forge(path, text, arrays)
        assert "save the scene again" in refused(path), text[:20]


def test_forged_arrays_are_refused_by_their_fault(path):
    text, arrays = split(path)
    for name, at, number, message in (
        ("geometry_0_vertices", (0, 0), np.nan, "corner: vertex 0 has a coordinate that is not finite"),
        ("geometry_0_vertices", (0, 0), 1e300, "float64 has no room"),
        ("geometry_0_faces", (0, 0), -1, "face 0 refers to vertex -1"),
        ("geometry_1_radii", 0, -1, "dots: sphere 0 has the radius -1"),
        ("transforms", (0, 0, 0), 0, "the transform of instance 0 is singular"),
        ("colours", (0, 0), 1, "the colour of instance 0 is not three finite numbers"),
        ("geometry_ids", 2, -1, "instance 2 has -1 among its geometry_ids, of 2"),
        ("material_ids", 1, -2, "instance 1 has -2 among its material_ids, of 1"),
    ):
        changed = arrays[name].copy()
        changed[at] = number
        forge(path, text, arrays | {name: changed})
        assert message in refused(path), (name, number)
    for name in ("texture_0", "geometry_0_colours"):
        forge(path, text, arrays | {name: arrays[name].astype(np.float32)})
        assert "must be uint8" in refused(path)
    for name in ("transforms", "colours", "geometry_ids", "masks", "material_ids"):
        for other in (arrays[name][:2], arrays[name][None], arrays[name].astype(">f8")):
            forge(path, text, arrays | {name: other})
            assert f"its array '{name}' does not fit 3 instances" in refused(path)
        forge(path, text, {key: values for key, values in arrays.items() if key != name})
        assert f"KeyError: '{name}'" in refused(path)


def test_random_forgeries_are_loaded_or_refused(path):
    rng, refusals = np.random.default_rng(0), 0
    document, arrays = split(path)
    text = np.frombuffer(json.dumps(document).encode(), np.uint8)
    for number in range(300):
        forged = {name: values.copy() for name, values in arrays.items()} | {"text": text.copy()}
        data = forged["text" if number % 2 else rng.choice(list(arrays))].reshape(-1).view(np.uint8)
        data[rng.integers(len(data), size=rng.integers(1, 9))] = rng.integers(256)
        forge(path, forged.pop("text").tobytes(), forged)
        try:
            clbvh.Scene.load(path)
        except SceneError:
            refusals += 1
    assert 50 < refusals < 290
