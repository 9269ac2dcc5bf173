"""The readers that are fuzzed: how a damaged file is made for each, and what its reading may end in.

A reader gives a valid result or refuses the file with a `ClbvhError` for bad input, which the command turns into exit
code 2. Anything else is a failure: another exception, a warning (but for those about looks, which leave the triangles
valid), an invalid result, and running out of memory even where that becomes an error of one sentence, since a small
file never needs much.

Geometry against the oracle is another target of the same shape: see `geometry.py`.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from clbvh import Bvh, build, load_mesh, validate_tree
from clbvh.bvh import serialize
from clbvh.errors import ClbvhError
from clbvh.geometry import Mesh, Spheres
from clbvh.geometry.loading.spheres_file import read_spheres
from clbvh.rendering.scene_file import SceneObject, parse_scene_file, read_scene_file
from clbvh.scene.scene import Scene

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


def _check_mesh(mesh: Mesh) -> None:
    assert mesh.vertices.shape[1:] == mesh.faces.shape[1:] == (3,)
    assert np.isfinite(mesh.vertices).all()
    assert np.isfinite(mesh.origin).all()
    assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)


def _read_mesh(content: bytes, folder: Path, suffix: str) -> bool:
    path = folder / f"a.{suffix}"
    path.write_bytes(content)
    return accepts(lambda: _check_mesh(load_mesh(path)))


def _mesh_reader(suffix: str, originals: Sequence[bytes]) -> Reader:
    donors = [content for files in samples.MESH_FILES.values() for content in files]
    return Reader(
        originals,
        lambda generator: mutate(generator.choice(originals), generator, generator.choice((originals, donors))),
        lambda content, folder: _read_mesh(content, folder, suffix),
    )


def _pack(document: dict[str, Any], buffer: bytes, *, is_glb: bool) -> bytes:
    if is_glb:
        return pack_glb(json.dumps({"buffers": [{"byteLength": len(buffer)}]} | document).encode(), buffer)
    uri = "data:;base64," + base64.b64encode(buffer).decode()
    return json.dumps({"buffers": [{"byteLength": len(buffer), "uri": uri}]} | document).encode()


def _gltf_reader(*, is_glb: bool) -> Reader:
    parts = [(gltf.document, gltf.buffer) for gltf in samples.make_gltf_documents()]
    originals = [_pack(document, buffer, is_glb=is_glb) for document, buffer in parts]

    def make(generator: Random) -> bytes:
        """Damage the JSON values, the buffer, or the bytes of the whole file."""
        document, buffer = generator.choice(parts)
        kind = generator.random()
        if kind < 0.3:
            return mutate(_pack(document, buffer, is_glb=is_glb), generator, originals)
        if kind < 0.8:
            document = mutate_json(json.loads(json.dumps(document)), generator)
        if kind > 0.7:
            buffer = mutate(buffer, generator, [buffer])
        return _pack(document, buffer, is_glb=is_glb)

    return Reader(originals, make, lambda content, folder: _read_mesh(content, folder, "glb" if is_glb else "gltf"))


def _read_scene(content: bytes, folder: Path) -> bool:
    path = folder / "a.toml"
    path.write_bytes(content)

    def read() -> None:
        file = parse_scene_file(path)
        assert file.view.width >= 1
        assert file.view.height >= 1
        copies = [found.count for found in file.objects.values()]
        if all(map(_is_quick, file.objects.values())) and max(copies) < _FEW_COPIES:
            _check_scene(read_scene_file(path)[0], sum(copies))

    return accepts(read)


def _is_quick(found: SceneObject) -> bool:
    """Return whether a source loads in a moment, or is refused."""
    source = dict(found.source)
    size = source.get("triangles", source.get("number", 0 if "centres" in source else _SMALL_SHAPE + 1))
    return not _SMALL_SHAPE < size < _HUGE_SHAPE


def _check_scene(scene: Scene, instance_count: int) -> None:
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


def _read_spheres(content: bytes, folder: Path, suffix: str) -> bool:
    path = folder / f"a.{suffix}"
    path.write_bytes(content)

    def read() -> None:
        centres, radii = read_spheres(path)
        spheres = Spheres(centres, 1.0 if radii is None else radii)
        assert spheres.centres.shape == (spheres.prim_count, 3)
        assert np.isfinite(spheres.centres).all()

    return accepts(read)


def _spheres_reader(suffix: str, originals: Sequence[bytes]) -> Reader:
    return Reader(
        originals,
        lambda generator: mutate(generator.choice(originals), generator, originals),
        lambda content, folder: _read_spheres(content, folder, suffix),
    )


def _tree_reader() -> Reader:
    tree = build(make_soup(12, seed=3), leaf_size=2)
    header_bytes = serialize._HEADER.size
    words = np.concatenate([tree.nodes["first"], tree.nodes["count"], tree.prim_ids]).astype("<i4")
    facts = (serialize.MAGIC, serialize.FORMAT_VERSION, tree.node_count, tree.mesh.face_count, tree.mesh.fingerprint)

    def seal(content: bytes) -> bytes:
        """Return a file whose digests fit its content, so that what lies behind them is reached."""
        digest = hashlib.sha256(content[header_bytes:]).digest()[:_DIGEST_BYTES]
        sealed = content[: header_bytes - 2 * _DIGEST_BYTES] + digest
        return sealed + hashlib.sha256(sealed).digest()[:_DIGEST_BYTES] + content[header_bytes:]

    original = seal(serialize._HEADER.pack(*facts, b"", b"") + words.tobytes())

    def make(generator: Random) -> bytes:
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

    def read(content: bytes, folder: Path) -> bool:
        path = folder / "a.tree"
        path.write_bytes(content)
        return accepts(lambda: validate_tree(Bvh.load(path, tree.mesh)))

    return Reader([original], make, read)


READERS: dict[str, Reader] = {
    **{suffix: _mesh_reader(suffix, originals) for suffix, originals in samples.MESH_FILES.items()},
    "glb": _gltf_reader(is_glb=True),
    "gltf": _gltf_reader(is_glb=False),
    "scene": Reader(
        samples.SCENE_FILES,
        lambda generator: mutate(generator.choice(samples.SCENE_FILES), generator, samples.SCENE_FILES),
        _read_scene,
    ),
    **{f"spheres-{suffix}": _spheres_reader(suffix, originals) for suffix, originals in samples.SPHERES_FILES.items()},
    "tree": _tree_reader(),
}
