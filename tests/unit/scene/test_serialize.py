"""Scenes in files: a saved scene comes back, and every other content is refused."""

from __future__ import annotations

import hashlib
import json
import re
import struct

import numpy as np
import pytest

import clbvh
from clbvh.errors import ClbvhError, ConfigError, SceneError
from clbvh.scene import serialize

HEADER_BYTES = 64
MAGIC = b"\x8bSCN\r\n\x1a\n"
VERSION_AT, ZERO_AT = 8, 12
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


def split(content):
    """Return the text of a file, as JSON, and its arrays."""
    text_bytes, _ = struct.unpack_from("<QQ", content, 16)
    return json.loads(content[HEADER_BYTES : HEADER_BYTES + text_bytes]), content[HEADER_BYTES + text_bytes :]


def forge(text, data, *, text_bytes=None, data_bytes=None):
    """Return a file whose digests are right, whatever it holds."""
    if not isinstance(text, bytes):
        text = json.dumps(text).encode()
        text += b" " * (-len(text) % 8)
    digest = hashlib.sha256(text + data).digest()[:16]
    sizes = len(text) if text_bytes is None else text_bytes, len(data) if data_bytes is None else data_bytes
    facts = struct.pack("<8sIIQQ16s", MAGIC, 1, 0, *sizes, digest)
    return facts + hashlib.sha256(facts).digest()[:16] + text + data


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
    def test_a_forged_file_with_the_right_content_is_loaded(self, path, content):
        """So that the refusals below are about the content and not about the forging."""
        path.write_bytes(forge(*split(content)))
        same(make_scene(), clbvh.Scene.load(path))

    def test_every_changed_byte_is_noticed(self, path, content):
        for at in (*range(HEADER_BYTES), *range(HEADER_BYTES, len(content), 7)):
            damaged = bytearray(content)
            damaged[at] ^= 0x10
            message = refused(path, damaged)
            if at < VERSION_AT:
                assert "not a saved scene" in message
            elif at < ZERO_AT:
                assert "format" in message
            else:
                assert "damaged or was cut off" in message

    def test_every_cut_is_noticed(self, path, content):
        for size in (*range(HEADER_BYTES), *range(HEADER_BYTES, len(content), 7)):
            assert ("not a saved scene" if size < len(MAGIC) else "cut off") in refused(path, content[:size])
        assert "damaged" in refused(path, content + b"\0")

    def test_another_format_is_named(self, path, content):
        assert "in format 2, and this version of clbvh reads format 1" in refused(
            path, content[:VERSION_AT] + b"\2" + content[VERSION_AT + 1 :]
        )

    @pytest.mark.parametrize("size", [0, 4, 8, 2**31, 2**40, 2**63, 2**64 - 8])
    def test_sizes_that_lie_allocate_nothing(self, path, content, size):
        assert "damaged" in refused(path, forge(*split(content), text_bytes=size))
        assert "damaged" in refused(path, forge(*split(content), data_bytes=size))
        assert "damaged" in refused(path, forge(*split(content), text_bytes=size, data_bytes=(2**64 - size) % 2**64))

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
            (["geometries"], MISSING, "no 'geometries'"),
            (["geometries"], 5, "wrong 'geometries'"),
            (["geometries"], [], "names|arrays|geometry"),
            (["geometries", 0], 5, "no 'kind'"),
            (["geometries", 0, "kind"], "teapot", "unknown kind 'teapot'"),
            (["geometries", 0, "kind"], "spheres", "no 'count'"),
            (["geometries", 0, "name"], "Sterne ★", "geometry with the name 'Sterne ★' already"),
            (["geometries", 0, "name"], "", "must be a text"),
            (["geometries", 0, "name"], 5, "wrong 'name'"),
            (["geometries", 0, "shape_name"], None, "wrong 'shape_name'"),
            (["geometries", 0, "vertices"], 0, "refers|arrays|no vertices"),
            (["geometries", 0, "vertices"], 2, "."),
            (["geometries", 0, "vertices"], -1, "wrong 'vertices'"),
            (["geometries", 0, "vertices"], 1.0, "wrong 'vertices'"),
            (["geometries", 0, "vertices"], True, "wrong 'vertices'"),
            (["geometries", 0, "vertices"], 2**62, "arrays of"),
            (["geometries", 0, "faces"], 10**300, "arrays of"),
            (["geometries", 0, "faces"], 0, "."),
            (["geometries", 1, "count"], 2**31, "arrays of"),
            (["instances"], MISSING, "no 'instances'"),
            (["instances", "count"], 2, "arrays of"),
            (["instances", "count"], 2**40, "arrays of"),
            (["instances", "names"], [], "0 names for 3 instances"),
            (["instances", "names", 0], "Sterne ★", "instance with the name"),
            (["instances", "names", 0], {}, "must be a text"),
            (["settings"], MISSING, "no 'settings'"),
            (["settings"], [], "wrong 'settings'"),
        ],
    )
    def test_it_is_refused_by_its_fault(self, path, content, keys, value, message):
        document, data = split(content)
        found = refused(path, forge(changed(document, keys, value), data))
        assert "the file is whole, but" in found
        # Behind the name of the file, which may hold anything.
        assert re.search(message, found.removeprefix(str(path)))

    @pytest.mark.parametrize(
        "text",
        [b"", b"        ", b"[" * 100_000, b'{"geometries":  ', b"\xff" * 8, b"9" * 8000, b"null    ", b"[]      "],
    )
    def test_a_text_that_is_no_object_is_refused(self, path, content, text):
        assert "makes no scene" in refused(path, forge(text, split(content)[1]))

    def test_arrays_that_are_left_over_are_refused(self, path, content):
        document, data = split(content)
        assert "its text tells of arrays of" in refused(path, forge(document, data + bytes(8)))


# Where the arrays of `make_scene` begin.
VERTICES_AT, FACES_AT, CENTRES_AT = 0, 72, 88
RADII_AT = CENTRES_AT + 72
TRANSFORMS_AT = RADII_AT + 24
COLOURS_AT = TRANSFORMS_AT + 3 * 128
IDS_AT = COLOURS_AT + 3 * 24


class TestForgedArrays:
    @pytest.mark.parametrize(
        ("at", "number", "message"),
        [
            (VERTICES_AT, struct.pack("<d", np.nan), "corner: vertex 0 has a coordinate that is not finite"),
            (VERTICES_AT, struct.pack("<d", 1e300), "float64 has no room"),
            (FACES_AT, struct.pack("<i", 3), "face 0 refers to vertex 3"),
            (FACES_AT, struct.pack("<i", -1), "face 0 refers to vertex -1"),
            (CENTRES_AT, struct.pack("<d", np.inf), "dots: sphere 0"),
            (RADII_AT, struct.pack("<d", -1), "dots: sphere 0 has the radius -1"),
            (TRANSFORMS_AT, struct.pack("<d", 0), "the transform of instance 0 is singular"),
            (TRANSFORMS_AT + 128, struct.pack("<d", np.nan), "the transform of instance 1 must be finite"),
            (TRANSFORMS_AT + 256 + 96, struct.pack("<d", 1), "the transform of instance 2 must be affine"),
            (COLOURS_AT, struct.pack("<d", 1), "the colour of instance 0 is not"),
            (COLOURS_AT + 24, struct.pack("<d", np.inf), "the colour of instance 1 is not"),
            (IDS_AT, struct.pack("<i", 2), "instance 0 is of geometry 2, but it has 2"),
            (IDS_AT + 8, struct.pack("<i", -1), "instance 2 is of geometry -1, but it has 2"),
        ],
    )
    def test_they_are_refused_by_their_fault(self, path, content, at, number, message):
        document, data = split(content)
        forged = bytearray(data)
        forged[at : at + len(number)] = number
        assert message in refused(path, forge(document, bytes(forged)))


def scramble(rng, text, data):
    """Return a file with random faults whose digests are right."""
    text, data = bytearray(text), bytearray(data)
    kind = rng.integers(6)
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
    elif kind == 3:  # bytes of the arrays
        for _ in range(rng.integers(1, 20)):
            data[rng.integers(len(data))] = rng.integers(256)
    elif kind == 4:  # arrays cut or grown
        size = 8 * rng.integers(0, len(data) // 4)
        data = (data + bytes(len(data)))[:size]
    else:  # whole words of the arrays
        at = 4 * rng.integers(len(data) // 4)
        data[at : at + 4] = rng.choice([b"\0\0\0\0", b"\xff\xff\xff\xff", b"\0\0\0\x80", b"\xff\xff\xff\x7f"])
    text += b" " * (-len(text) % 8)
    return forge(bytes(text), bytes(data))


@pytest.mark.parametrize("seed", range(4))
def test_random_forgeries_are_loaded_or_refused(path, content, seed):
    rng = np.random.default_rng(seed)
    document, data = split(content)
    text = json.dumps(document).encode()
    results = {True: 0, False: 0}
    for _ in range(500):
        path.write_bytes(scramble(rng, text, data))
        message = None
        try:
            clbvh.Scene.load(path)
        except SceneError as error:
            message = str(error)
        results[message is None] += 1
        assert message is None or message.startswith(f"{path}: ")
    assert results[False] > 100
    assert results[True] > 10
