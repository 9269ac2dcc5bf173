"""The readers that are fuzzed: how a damaged file is made for each, and what its reading may end in.

A reader gives a valid result or refuses the file with a `ClbvhError` for bad input, which the command turns into exit
code 2. Anything else is a failure: another exception, a warning (but for those about looks, which leave the triangles
valid), an invalid result, and running out of memory even where that becomes an error of one sentence, since a small
file never needs much.

Geometry against the oracle is another target of the same shape: see `geometry.py`.
"""

import base64
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random

import numpy as np

from clbvh import Bvh, ClbvhError, Mesh, Spheres, build, load_mesh, validate_tree
from clbvh.bvh import serialize
from clbvh.files.scene_file import parse_scene_file, read_scene_file
from clbvh.geometry.loading.spheres_file import read_spheres

from ..soup import make_soup
from ..unit.geometry.gltf_files import pack_glb
from . import samples
from .mutate import mutate, mutate_json

_SMALL_SHAPE, _HUGE_SHAPE = 5000, 10**12  # triangles: shapes in between would take their time, rightly
_FEW_COPIES = 5000
_DIGEST_BYTES = 16


@dataclass(frozen=True)
class Reader:
    """One reader of files; `read` gets a folder of its own. What it raises is a failure."""

    originals: Sequence[bytes]  # valid files
    make: Callable[[Random], bytes]  # a damaged file
    read: Callable[[bytes, Path], bool]  # whether it was accepted


def accepts(read: Callable[[], object]) -> bool:
    """Return whether a file was accepted; raise what no reader may raise."""
    try:
        read()
    except ClbvhError as error:
        if isinstance(error.__cause__, MemoryError):
            raise error.__cause__ from error
        if not isinstance(error, ValueError) or "\n" in str(error):
            raise
        return False
    return True


def _make_reader(originals, donors, suffix, check):
    """Return the reader of a format: `check` loads the file, and sees whether the result is valid."""

    def read(content, folder):
        path = folder / f"a.{suffix}"
        path.write_bytes(content)
        return accepts(lambda: check(path))

    return Reader(originals, lambda generator: mutate(generator.choice(originals), generator, donors), read)


def _check_mesh(mesh):
    assert mesh.vertices.shape[1:] == mesh.faces.shape[1:] == (3,)
    assert np.isfinite(mesh.vertices).all()
    assert np.isfinite(mesh.origin).all()
    assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)


def _load_mesh(path):
    _check_mesh(load_mesh(path))


def _pack(document, buffer, suffix):
    if suffix == "glb":
        return pack_glb(json.dumps({"buffers": [{"byteLength": len(buffer)}]} | document).encode(), buffer)
    uri = "data:;base64," + base64.b64encode(buffer).decode()
    return json.dumps({"buffers": [{"byteLength": len(buffer), "uri": uri}]} | document).encode()


def _gltf_reader(suffix):
    parts = [(gltf.document, gltf.buffer) for gltf in samples.make_gltf_documents()]
    originals = [_pack(document, buffer, suffix) for document, buffer in parts]

    def make(generator):
        """Damage the JSON values, the buffer, or the bytes of the whole file."""
        document, buffer = generator.choice(parts)
        kind = generator.random()
        if kind < 0.3:
            return mutate(_pack(document, buffer, suffix), generator, originals)
        if kind < 0.8:
            document = mutate_json(json.loads(json.dumps(document)), generator)
        if kind > 0.7:
            buffer = mutate(buffer, generator, [buffer])
        return _pack(document, buffer, suffix)

    return replace(_make_reader(originals, originals, suffix, _load_mesh), make=make)


def _load_scene(path):
    file = parse_scene_file(path)
    assert min(file.view.width, file.view.height) >= 1
    copies = [found.count for found in file.objects.values()]
    if all(map(_is_quick, file.objects.values())) and max(copies) < _FEW_COPIES:
        scene = read_scene_file(path)[0]
        # What is flattened is not placed, and a point where nothing is.
        count, is_flattened = len(scene.instances), any(map(_is_flattened, file.objects.values()))
        assert 0 < count <= sum(copies)
        _check_scene(scene, count if is_flattened else sum(copies))


def _is_flattened(found):
    """Return whether the transform of an object, or one of its copies', may be singular to within rounding."""
    return not np.linalg.cond(found.transform[:3, :3]) < 1e6


def _is_quick(found):
    """Return whether a source loads in a moment, or is refused."""
    source = dict(found.source)
    size = source.get("triangles", source.get("number", 0 if "centres" in source else _SMALL_SHAPE + 1))
    return not _SMALL_SHAPE < size < _HUGE_SHAPE


def _check_scene(scene, instance_count):
    state = scene.snapshot()
    assert state.instance_count == instance_count == len(set(state.instance_names))
    assert np.isfinite(state.transforms).all()
    assert (state.transforms[:, 3] == [0, 0, 0, 1]).all()
    for shape in state.shapes:
        if isinstance(shape, Mesh):
            _check_mesh(shape)
        else:
            assert np.isfinite(shape.centres).all()
            assert (shape.radii > 0).all()


def _load_spheres(path):
    centres, radii = read_spheres(path)
    spheres = Spheres(centres, 1.0 if radii is None else radii)
    assert spheres.centres.shape == (spheres.prim_count, 3)
    assert np.isfinite(spheres.centres).all()


def _tree_reader():
    tree = build(make_soup(12, seed=3), leaf_size=2)
    header_bytes = serialize._HEADER.size
    words = np.concatenate([tree.nodes["first"], tree.nodes["count"], tree.prim_ids]).astype("<i4")
    facts = (serialize.MAGIC, serialize.FORMAT_VERSION, tree.node_count, tree.mesh.face_count, tree.mesh.fingerprint)

    def seal(content):
        """Return a file whose digests fit its content, so that what lies behind them is reached."""
        digest = hashlib.sha256(content[header_bytes:]).digest()[:_DIGEST_BYTES]
        sealed = content[: header_bytes - 2 * _DIGEST_BYTES] + digest
        return sealed + hashlib.sha256(sealed).digest()[:_DIGEST_BYTES] + content[header_bytes:]

    original = seal(serialize._HEADER.pack(*facts, b"", b"") + words.tobytes())

    def make(generator):
        """Damage the bytes, or exchange and change links and leave the digests right."""
        if generator.random() < 0.4:
            content = mutate(original, generator, [original])
            return seal(content) if len(content) >= header_bytes and generator.random() < 0.5 else content
        changed = words.copy()
        if generator.random() < 0.2:  # another order of the triangles makes another valid tree
            changed[2 * tree.node_count :] = generator.sample(range(tree.mesh.face_count), tree.mesh.face_count)
        for _ in range(generator.randrange(4)):
            places = [generator.randrange(len(changed)) for _ in range(2)]
            changed[places] = changed[places[::-1]]
            if generator.random() < 0.5:
                changed[places[0]] = generator.choice((-1, 0, 1, 2, 2**31 - 1, -(2**31), generator.randrange(25)))
        return seal(original[:header_bytes] + changed.tobytes())

    reader = _make_reader([original], [original], "tree", lambda path: validate_tree(Bvh.load(path, tree.mesh)))
    return replace(reader, make=make)


_ALL_MESHES = [content for files in samples.MESH_FILES.values() for content in files]
READERS = {
    **{suffix: _make_reader(files, _ALL_MESHES, suffix, _load_mesh) for suffix, files in samples.MESH_FILES.items()},
    "glb": _gltf_reader("glb"),
    "gltf": _gltf_reader("gltf"),
    "scene": _make_reader(samples.SCENE_FILES, samples.SCENE_FILES, "toml", _load_scene),
    "spheres-npz": _make_reader(*[samples.SPHERES_FILES["npz"]] * 2, "npz", _load_spheres),
    "spheres-csv": _make_reader(*[samples.SPHERES_FILES["csv"]] * 2, "csv", _load_spheres),
    "tree": _tree_reader(),
}
