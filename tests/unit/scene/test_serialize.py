"""Scenes in files: a saved scene comes back, and every other content is refused."""

from __future__ import annotations

import copy
import json
import re
import zipfile

import numpy as np
import pytest

import clbvh
from clbvh.errors import ClbvhError, ConfigError, SceneError
from clbvh.scene import serialize

BEGINNING = b"PK\3\4" + bytes(26) + b"clbvh_scene.npy"
MESH = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="corner")
DOTS = clbvh.Spheres([[0, 0, 0], [5, 0, 0], [0, 1e-30, 7]], [1, 2, 1e-3], name="dots")
ALL_BITS = 2**32 - 1


def make_scene():
    scene = clbvh.Scene(MESH)
    dots = scene.add(DOTS, name="Sterne ★")
    scene.place(dots, clbvh.Transform(scale=3, rotate=(1, 2, 3), translate=(1e7, 0, -0.0)), mask=5, colour=(1, 0, 0.5))
    scene.place(dots, np.diag([-1e-30, 1, 1, 1]))
    return scene


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "a.scene"
    make_scene().save(path)
    return path


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    path = tmp_path_factory.mktemp("saved") / "a.scene"
    make_scene().save(path)
    return path.read_bytes()


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


def refused(path, content=None):
    """Return the one sentence with which a file is refused."""
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SceneError) as caught:
        clbvh.Scene.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def same(first, second):
    mine, theirs = first.snapshot(), second.snapshot()
    assert mine.names == theirs.names
    assert mine.instance_names == theirs.instance_names
    for array in ("transforms", "masks", "geometry_ids", "colours"):
        assert getattr(mine, array).dtype == getattr(theirs, array).dtype
        assert getattr(mine, array).tobytes() == getattr(theirs, array).tobytes()
    for one, other in zip(mine.shapes, theirs.shapes, strict=True):
        assert type(one) is type(other)
        assert one.name == other.name
        assert one.fingerprint == other.fingerprint
        for array in ("vertices", "faces") if isinstance(one, clbvh.Mesh) else ("centres", "radii"):
            assert getattr(one, array).tobytes() == getattr(other, array).tobytes()


class TestRoundTrip:
    def test_a_saved_scene_comes_back(self, path):
        scene, loaded = make_scene(), clbvh.Scene.load(str(path))
        same(scene, loaded)
        assert [instance.mask for instance in loaded.instances] == [ALL_BITS, 5, ALL_BITS]
        assert [instance.colour for instance in loaded.instances] == [None, (1, 0, 0.5), None]
        assert loaded.find("Sterne ★").geometry.name == "Sterne ★"

    def test_it_is_saved_as_the_same_file(self, path, tmp_path):
        clbvh.Scene.load(path).save(tmp_path / "b.scene")
        assert (tmp_path / "b.scene").read_bytes() == path.read_bytes()

    def test_a_loaded_scene_grows(self, path):
        loaded = clbvh.Scene.load(path)
        assert loaded.add(MESH).name == "corner 2"
        assert loaded.place(loaded.geometries[1]).name == "Sterne ★ 3"
        assert loaded.snapshot().instance_count == 4

    def test_an_empty_scene(self, tmp_path):
        clbvh.Scene().save(tmp_path / "a.scene")
        assert clbvh.Scene.load(tmp_path / "a.scene").is_empty

    @pytest.mark.parametrize("count", [1000])
    def test_many_instances(self, tmp_path, count):
        rng = np.random.default_rng(1)
        scene = clbvh.Scene()
        geometries = [scene.add(MESH), scene.add(DOTS)]
        for number in range(count):
            matrix = np.eye(4)
            matrix[:3] = rng.normal(size=(3, 4)) * 10.0 ** rng.uniform(-30, 30)
            scene.place(geometries[number % 2], matrix, mask=int(rng.integers(2**32)))
        scene.save(tmp_path / "a.scene")
        same(scene, clbvh.Scene.load(tmp_path / "a.scene"))

    def test_numbers_and_texts_of_numpy_come_back(self, tmp_path):
        scene = clbvh.Scene()
        scene.place(scene.add(MESH, name=np.str_("a")), name=np.str_("b"))
        camera = clbvh.Camera(tuple(np.linspace(1, 2, 3)), (0, 0, 0), fov=np.float64(40.5)).orbit(30)
        clbvh.save_scene(tmp_path / "a.scene", scene, clbvh.View(camera=camera))
        loaded, view = clbvh.open_scene(tmp_path / "a.scene")
        same(scene, loaded)
        assert view.camera == camera

    def test_odd_names_come_back(self, tmp_path):
        scene = clbvh.Scene()
        wanted = ['"', "\\", "a\n", "\0", "ß \U0001f600", "a" * 5000]
        mesh = clbvh.Mesh.from_arrays(MESH.vertices, MESH.faces, name="\ud800")
        for name in wanted:
            scene.place(scene.add(mesh, name=name), name=name)
        scene.save(tmp_path / "a.scene")
        loaded = clbvh.Scene.load(tmp_path / "a.scene")
        assert [geometry.name for geometry in loaded.geometries] == wanted
        assert loaded.geometries[0].shape.name == "\ud800"


class TestDamage:
    def test_a_forged_file_with_the_right_content_is_loaded(self, path):
        """So that the refusals below are about the content and not about the forging."""
        forge(path, *split(path))
        same(make_scene(), clbvh.Scene.load(path))

    def test_every_changed_byte_is_noticed_or_changes_nothing(self, path, content):
        refusals = []
        for at in range(0, len(content), 7):
            damaged = bytearray(content)
            damaged[at] ^= 1 << at % 8
            path.write_bytes(damaged)
            try:
                loaded = clbvh.Scene.load(path)
            except SceneError as error:
                refusals.append(str(error))
            else:
                same(make_scene(), loaded)
        assert len(refusals) > len(content) // 14
        assert all(re.fullmatch(f"{path}: .*", message) for message in refusals)

    def test_every_cut_is_noticed(self, path, content):
        for size in (*range(60), *range(60, len(content), 7)):
            expected = "not a saved scene" if size < len(BEGINNING) else "damaged or was cut off"
            assert expected in refused(path, content[:size])

    def test_another_format_is_named(self, path):
        text, arrays = split(path)
        forge(path, text | {"format": 2, "more": 3}, arrays)
        assert "has the format 2, and this version of clbvh reads format 1" in refused(path)

    @pytest.mark.parametrize("shape", ["(1,)", "(2, 4, 4)", "(4, 4, 4)", "(99999999999999, 4, 4)", "(-3, 4, 4)"])
    def test_shapes_that_lie_allocate_nothing(self, path, shape):
        text, arrays = split(path)
        forge(path, text, arrays)
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        old = members["transforms.npy"]
        texts = [f"{each}, }}".ljust(30).encode() for each in ("(3, 4, 4)", shape)]
        members["transforms.npy"] = old.replace(*texts)
        assert members["transforms.npy"] != old
        with zipfile.ZipFile(path, "w") as archive:
            for name, member in members.items():
                archive.writestr(name, member)
        assert "save the scene again" in refused(path)

    def test_nothing_in_a_file_expands(self, path):
        text, arrays = split(path)
        forge(path, text, arrays, save=np.savez_compressed)
        assert "packed, or larger than the file" in refused(path)
        forge(path, text, arrays)
        with zipfile.ZipFile(path, "a") as archive:
            for number in range(50):
                twice = copy.copy(archive.getinfo("transforms.npy"))
                twice.filename = f"settings_{number}.npy"
                archive.filelist.append(twice)
            archive.comment = b"changed"  # so that the list of members is written
        assert "packed, or larger than the file" in refused(path)

    def test_objects_are_not_unpickled(self, path):
        text, arrays = split(path)
        forge(path, text, arrays | {"masks": np.array([5, None, 7])})
        assert "masks must be numbers, not object" in refused(path)

    def test_other_files_are_refused(self, path, tmp_path):
        for other in (b"", b"ply\n", bytes(1000), b"\x8bBVH\r\n\x1a\n" + bytes(200)):
            assert "not a saved scene" in refused(path, other)
        assert "no such file" in refused(tmp_path / "gone.scene")
        assert "cannot be read" in refused(tmp_path)
        assert issubclass(SceneError, ClbvhError)

    @pytest.mark.parametrize("name", [5, None, "a\0b"])
    def test_something_that_names_no_file_is_refused(self, name):
        with pytest.raises(SceneError, match="not the path of a file"):
            clbvh.Scene.load(name)
        with pytest.raises(ConfigError, match="not the path of a file"):
            make_scene().save(name)

    def test_a_target_that_cannot_be_is_refused(self, tmp_path):
        with pytest.raises(ConfigError, match="does not exist"):
            make_scene().save(tmp_path / "gone" / "a.scene")
        with pytest.raises(ConfigError, match="this is a folder"):
            make_scene().save(tmp_path)

    def test_a_failed_save_leaves_the_old_file_and_nothing_else(self, path, monkeypatch):
        before = path.read_bytes()

        def fail(target, write):
            def write_half(file):
                write(file)
                raise OSError("no space left on device")

            whole(target, write_half)

        whole = serialize.write_atomically
        monkeypatch.setattr(serialize, "write_atomically", fail)
        with pytest.raises(OSError, match="no space"):
            clbvh.Scene().save(path)
        assert [file.name for file in path.parent.iterdir()] == [path.name]
        assert path.read_bytes() == before


MISSING = object()


def changed(document, keys, value):
    """Return a copy of a document with another value at a path of keys."""
    document = json.loads(json.dumps(document))
    table = document
    for key in keys[:-1]:
        table = table[key]
    if value is MISSING:
        del table[keys[-1]]
    else:
        table[keys[-1]] = value
    return document


class TestForgedText:
    @pytest.mark.parametrize(
        ("keys", "value", "message"),
        [
            (["geometries"], MISSING, "missing required field `geometries`"),
            (["geometries"], 5, r"Expected `array`, got `int` - at `\$.geometries`"),
            (["geometries"], [], "instance 0 has 0 among its geometry_ids, of 0"),
            (["geometries", 0], 5, "Expected `object`, got `int`"),
            (["geometries", 0, "kind"], "teapot", "Invalid enum value 'teapot'"),
            (["geometries", 0, "kind"], "spheres", "KeyError: 'geometry_0_centres'"),
            (["geometries", 0, "name"], "Sterne ★", "geometry with the name 'Sterne ★' already"),
            (["geometries", 0, "name"], "", "must be a text"),
            (["geometries", 0, "name"], 5, r"Expected `str`, got `int` - at `\$.geometries\[0\].name`"),
            (["geometries", 0, "shape_name"], None, "Expected `str`, got `null`"),
            (["geometries", 0, "spin"], 5, "unknown field `spin`"),
            (["geometries", 0, "parts"], [["a", 0, 10**300]], "the part 'a' has the faces"),
            (["geometries", 0, "parts"], [["a", 0, 2]], "the part 'a' has the faces 0 to 2"),
            (["geometries", 1, "parts"], MISSING, "missing required field `parts`"),
            (["instance_names"], [], "does not fit 0 instances"),
            (["instance_names", 0], "Sterne ★", "instance with the name"),
            (["instance_names", 0], {}, "Expected `str`, got `object`"),
            (["settings"], MISSING, "missing required field `settings`"),
            (["settings"], [], "Expected `object`, got `array`"),
            (["format"], MISSING, "has the format None"),
            (["format"], {"a": 1}, "has the format {'a': 1}"),
        ],
    )
    def test_it_is_refused_by_its_fault(self, path, keys, value, message):
        text, arrays = split(path)
        forge(path, changed(text, keys, value), arrays)
        # Behind the name of the file, which may hold anything.
        assert re.search(message, refused(path).removeprefix(str(path)))

    @pytest.mark.parametrize("text", [b"", b"[" * 100_000, b'{"format": 1', b"\xff" * 8, b"9" * 8000, b"null", b"[]"])
    def test_a_text_that_is_no_object_is_refused(self, path, text):
        forge(path, text, split(path)[1])
        assert "save the scene again" in refused(path)


class TestForgedArrays:
    @pytest.mark.parametrize(
        ("name", "at", "number", "message"),
        [
            ("geometry_0_vertices", (0, 0), np.nan, "corner: vertex 0 has a coordinate that is not finite"),
            ("geometry_0_vertices", (0, 0), 1e300, "float64 has no room"),
            ("geometry_0_faces", (0, 0), 3, "face 0 refers to vertex 3"),
            ("geometry_0_faces", (0, 0), -1, "face 0 refers to vertex -1"),
            ("geometry_1_centres", (0, 0), np.inf, "dots: sphere 0"),
            ("geometry_1_radii", 0, -1, "dots: sphere 0 has the radius -1"),
            ("transforms", (0, 0, 0), 0, "the transform of instance 0 is singular"),
            ("transforms", (1, 0, 0), np.nan, "the transform of instance 1 must be finite"),
            ("transforms", (2, 3, 0), 1, "the transform of instance 2 must be affine"),
            ("colours", (0, 0), 1, "the colour of instance 0 is not three finite numbers"),
            ("colours", (1, 0), np.inf, "the colour of instance 1 is not three finite numbers"),
            ("geometry_ids", 0, 2, "instance 0 has 2 among its geometry_ids, of 2"),
            ("geometry_ids", 2, -1, "instance 2 has -1 among its geometry_ids, of 2"),
            ("material_ids", 1, 0, "instance 1 has 0 among its material_ids, of 0"),
            ("material_ids", 1, -2, "instance 1 has -2 among its material_ids, of 0"),
        ],
    )
    def test_they_are_refused_by_their_fault(self, path, name, at, number, message):
        text, arrays = split(path)
        arrays[name][at] = number
        forge(path, text, arrays)
        assert message in refused(path)

    @pytest.mark.parametrize("name", ["transforms", "colours", "geometry_ids", "masks", "material_ids"])
    def test_each_must_fit_the_instances(self, path, name):
        text, arrays = split(path)
        for other in (arrays[name][:2], arrays[name][None], arrays[name].astype(">f8")):
            forge(path, text, arrays | {name: other})
            assert f"its array '{name}' does not fit 3 instances" in refused(path)
        del arrays[name]
        forge(path, text, arrays)
        assert f"KeyError: '{name}'" in refused(path)


def scramble(rng, path, text, arrays):
    """Write a file with random faults whose checksums are right."""
    text, arrays = bytearray(text), {name: values.copy() for name, values in arrays.items()}
    kind = rng.integers(6)
    data = arrays[rng.choice(list(arrays))].reshape(-1).view(np.uint8)
    if kind == 0:  # bytes of the text
        for _ in range(rng.integers(1, 4)):
            text[rng.integers(len(text))] = rng.integers(256)
    elif kind == 1:  # digits, so that the text stays JSON
        digits = [at for at, byte in enumerate(text) if chr(byte).isdigit()]
        for at in rng.choice(digits, rng.integers(1, 5)):
            text[at] = ord(str(rng.integers(10)))
    elif kind == 2:  # a piece of the text moved
        begin, end, to = np.sort(rng.integers(0, len(text), 3))
        text = text[:begin] + text[end:to] + text[begin:end] + text[to:]
    elif kind == 3:  # bytes of an array
        data[rng.integers(len(data), size=rng.integers(1, 20))] = rng.integers(256)
    elif kind == 4:  # an array cut, or in the place of another
        one, other = rng.choice(list(arrays), 2)
        arrays[one] = arrays[other][: rng.integers(4)]
    else:  # whole words of an array
        at = 4 * rng.integers(len(data) // 4)
        data[at : at + 4] = rng.choice([0, 255, 127])
    forge(path, bytes(text), arrays)


@pytest.mark.parametrize("seed", range(4))
def test_random_forgeries_are_loaded_or_refused(path, seed):
    rng = np.random.default_rng(seed)
    document, arrays = split(path)
    text = json.dumps(document).encode()
    results = {True: 0, False: 0}
    for _ in range(500):
        scramble(rng, path, text, arrays)
        message = None
        try:
            clbvh.Scene.load(path)
        except SceneError as error:
            message = str(error)
        results[message is None] += 1
        assert message is None or message.startswith(f"{path}: ")
    assert results[False] > 100
    assert results[True] > 10
