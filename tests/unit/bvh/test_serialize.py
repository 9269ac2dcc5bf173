"""Trees in files: a saved tree comes back, and every other content is refused."""

from __future__ import annotations

import dataclasses
import hashlib
import struct

import numpy as np
import pytest

from clbvh import Bvh, Mesh, build
from clbvh.bvh import serialize as store
from clbvh.errors import ClbvhError, ConfigError, TreeFileError

from ...rays import mesh_as_on_device
from ...soup import make_soup
from ..hand_made import make_leaf, make_tree

HEADER_BYTES = 84
NODE_COUNT, FACE_COUNT = 5, 4
VERSION_AT, NODE_COUNT_AT, PRIM_COUNT_AT, FINGERPRINT_AT, DIGEST_AT = 8, 12, 16, 20, 52


@pytest.fixture
def path(tmp_path):
    """The file of the hand-made tree."""
    path = tmp_path / "a.tree"
    make_tree().save(path)
    return path


def forge(path, links, prim_ids, *, node_count=None, mesh=None):
    """Write a file whose sums are right, whatever its links are: (first, count) of each node."""
    payload = np.concatenate([np.array(links, "<i4").reshape(-1, 2).T.ravel(), np.array(prim_ids, "<i4")]).tobytes()
    facts = struct.pack("<8sIII", b"\x8bBVH\r\n\x1a\n", 2, node_count or len(links), len(prim_ids))
    facts += (mesh or make_tree().mesh).fingerprint + hashlib.sha256(payload).digest()[:16]
    path.write_bytes(facts + hashlib.sha256(facts).digest()[:16] + payload)


RIGHT_LINKS = [(1, 0), (0, 2), (3, 0), (2, 1), (3, 1)]
RIGHT_PRIMS = [0, 2, 3, 1]


def refused(path, mesh=None):
    """Return the one sentence with which a file is refused."""
    with pytest.raises(TreeFileError) as caught:
        Bvh.load(path, mesh or make_tree().mesh)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("count", [1, 2, 3, 5000])
def test_a_saved_tree_comes_back_byte_by_byte(tmp_path, count):
    bvh = build(make_soup(count, count, copies=0.1, degenerate=0.1))
    bvh.save(tmp_path / "a.tree")
    loaded = Bvh.load(str(tmp_path / "a.tree"), bvh.mesh)
    assert loaded.nodes.dtype == bvh.nodes.dtype
    assert loaded.nodes.tobytes() == bvh.nodes.tobytes()
    assert loaded.prim_ids.dtype == bvh.prim_ids.dtype
    assert loaded.prim_ids.tobytes() == bvh.prim_ids.tobytes()
    assert loaded.mesh is bvh.mesh
    assert set(loaded.timings_ms) == {"load"}


def test_the_file_has_the_size_that_the_format_says(path):
    assert path.stat().st_size == HEADER_BYTES + 8 * NODE_COUNT + 4 * FACE_COUNT


def test_a_forged_file_with_the_right_links_is_the_same_file(path, tmp_path):
    """So that the refusals below are about the links and not about the forging."""
    forge(tmp_path / "b.tree", RIGHT_LINKS, RIGHT_PRIMS)
    assert (tmp_path / "b.tree").read_bytes() == path.read_bytes()


def test_the_arrays_of_a_loaded_tree_can_be_written(path):
    loaded = Bvh.load(path, make_tree().mesh)
    loaded.nodes["count"][0] = 7
    loaded.prim_ids[0] = 7


def test_a_mesh_may_have_another_name(path):
    renamed = dataclasses.replace(make_tree().mesh, name="other")
    assert Bvh.load(path, renamed).mesh.name == "other"


def test_a_mesh_may_be_elsewhere_and_in_another_unit(tmp_path):
    bvh = build(make_soup(300, 1))
    bvh.save(tmp_path / "tree")
    moved = Mesh.from_arrays(bvh.mesh.vertices * 2.0**-70 + [0, 2.0**-60, 0], bvh.mesh.faces)
    assert moved.local_vertices.tobytes() == bvh.mesh.local_vertices.tobytes()
    assert Bvh.load(tmp_path / "tree", moved).nodes.tobytes() == bvh.nodes.tobytes()


def test_a_tree_of_another_mesh_is_refused(path):
    mesh = make_tree().mesh
    others = [
        mesh_as_on_device(mesh.local_vertices * [1, 1, 2], mesh.faces, "other"),
        mesh_as_on_device(mesh.local_vertices, mesh.faces[::-1], "other"),
        make_leaf(3).mesh,
    ]
    for other in others:
        assert f"another mesh than {other.name}" in refused(path, other)


@pytest.mark.parametrize("at", range(HEADER_BYTES + 8 * NODE_COUNT + 4 * FACE_COUNT))
def test_every_changed_byte_is_noticed(path, at):
    data = bytearray(path.read_bytes())
    data[at] ^= 0x10
    path.write_bytes(data)
    message = refused(path)
    if at < VERSION_AT:
        assert "not a saved tree" in message
    elif at < NODE_COUNT_AT:
        assert "format" in message
    else:
        assert "damaged or was cut off" in message


@pytest.mark.parametrize("size", range(HEADER_BYTES + 8 * NODE_COUNT + 4 * FACE_COUNT))
def test_every_cut_is_noticed(path, size):
    path.write_bytes(path.read_bytes()[:size])
    assert ("not a saved tree" if size < VERSION_AT else "damaged or was cut off") in refused(path)


def test_bytes_too_many_are_noticed(path):
    path.write_bytes(path.read_bytes() + b"\0")
    assert "damaged" in refused(path)


def test_another_format_is_named(path):
    data = bytearray(path.read_bytes())
    data[VERSION_AT] = 9
    path.write_bytes(data)
    message = refused(path)
    assert "format 9" in message
    assert "reads format 2" in message


@pytest.mark.parametrize("count", [0, 2, 7, 9, 2**31, 2**32 - 1])
def test_a_forged_number_of_nodes_allocates_nothing(tmp_path, count):
    forge(tmp_path / "a.tree", RIGHT_LINKS, RIGHT_PRIMS, node_count=count or None)
    if count == 0:
        forge(tmp_path / "a.tree", [], RIGHT_PRIMS)
    assert "damaged" in refused(tmp_path / "a.tree")


@pytest.mark.parametrize(
    ("links", "prim_ids"),
    [
        pytest.param([(0, 0), *RIGHT_LINKS[1:]], RIGHT_PRIMS, id="a node that is its own child"),
        pytest.param([*RIGHT_LINKS[:2], (1, 0), *RIGHT_LINKS[3:]], RIGHT_PRIMS, id="a child above its parent"),
        pytest.param([*RIGHT_LINKS[:2], (2, 0), *RIGHT_LINKS[3:]], RIGHT_PRIMS, id="a child that is its parent"),
        pytest.param([(1, 0), (3, 0), (3, 0), (0, 2), (2, 2)], RIGHT_PRIMS, id="children of two parents"),
        pytest.param([(1, 0), (2, 0), (0, 2), (2, 1), (3, 1)], RIGHT_PRIMS, id="a left child of two parents"),
        pytest.param(
            [(3, 0), (2, 0), (5, 0), (0, 1), (1, 1), (2, 1), (3, 1)], RIGHT_PRIMS, id="a right child of two parents"
        ),
        pytest.param([*RIGHT_LINKS[:2], (4, 0), *RIGHT_LINKS[3:]], RIGHT_PRIMS, id="a child behind the end"),
        pytest.param([*RIGHT_LINKS[:2], (2**31 - 1, 0), *RIGHT_LINKS[3:]], RIGHT_PRIMS, id="a child far behind"),
        pytest.param([*RIGHT_LINKS[:2], (-1, 0), *RIGHT_LINKS[3:]], RIGHT_PRIMS, id="a negative child"),
        pytest.param([(1, 0), (0, 2), (2, 2), (2, 1), (3, 1)], RIGHT_PRIMS, id="nodes that nothing reaches"),
        pytest.param([(1, 0), (0, 1), (1, 1), (2, 1), (3, 1)], RIGHT_PRIMS, id="leaves that nothing reaches"),
        pytest.param([(1, 0), (0, 2), (2, 1), (3, 0), (3, 1)], RIGHT_PRIMS, id="a circle that nothing reaches"),
        pytest.param([(1, 0), (0, -2), *RIGHT_LINKS[2:]], RIGHT_PRIMS, id="a negative count"),
        pytest.param([(1, 0), (0, -(2**31)), *RIGHT_LINKS[2:]], RIGHT_PRIMS, id="the lowest count"),
        pytest.param([(1, 0), (0, 2**31 - 1), *RIGHT_LINKS[2:]], RIGHT_PRIMS, id="a huge count"),
        pytest.param([(1, 0), (0, 1), *RIGHT_LINKS[2:]], RIGHT_PRIMS, id="a slot in no leaf"),
        pytest.param([(1, 0), (0, 3), *RIGHT_LINKS[2:]], RIGHT_PRIMS, id="a slot in two leaves"),
        pytest.param([*RIGHT_LINKS[:4], (4, 1)], RIGHT_PRIMS, id="a leaf behind the end"),
        pytest.param([*RIGHT_LINKS[:4], (-1, 1)], RIGHT_PRIMS, id="a leaf before the begin"),
        pytest.param(RIGHT_LINKS, [0, 2, 3, 3], id="a triangle twice"),
        pytest.param(RIGHT_LINKS, [0, 2, 3, 4], id="a triangle too high"),
        pytest.param(RIGHT_LINKS, [0, 2, -1, 1], id="a negative triangle, the last one from behind"),
        pytest.param(RIGHT_LINKS, [0, 2, 3, -(2**31)], id="the lowest triangle"),
    ],
)
def test_links_that_make_no_tree_are_refused(tmp_path, links, prim_ids):
    forge(tmp_path / "a.tree", links, prim_ids)
    assert "its nodes make no tree" in refused(tmp_path / "a.tree")


def test_a_large_forged_file_is_refused_in_a_short_sentence(tmp_path):
    bvh = build(make_soup(50_000, 1))
    links = np.stack((bvh.nodes["first"], bvh.nodes["count"]), axis=1)
    for leaves, prim_ids in ((links[:, 0], np.zeros_like(bvh.prim_ids)), (0 * links[:, 0], bvh.prim_ids)):
        links[:, 0] = np.where(links[:, 1] > 0, leaves, links[:, 0])
        forge(tmp_path / "a.tree", links, prim_ids, mesh=bvh.mesh)
        assert len(refused(tmp_path / "a.tree", bvh.mesh)) < 500


@pytest.mark.parametrize("count", [3, 5])
def test_a_forged_number_of_triangles_is_refused(tmp_path, count):
    forge(tmp_path / "a.tree", RIGHT_LINKS, range(count))
    assert "damaged" in refused(tmp_path / "a.tree")


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    assert "no such file" in refused(tmp_path / "gone.tree")
    assert "cannot be read" in refused(tmp_path)


def test_a_file_of_something_else_is_refused(tmp_path):
    for content in (b"", b"ply\n", bytes(1000), b"\x8bBVH\n\x1a\n" + bytes(200)):
        (tmp_path / "a.tree").write_bytes(content)
        assert "not a saved tree" in refused(tmp_path / "a.tree")


def test_what_is_refused_is_bad_input():
    assert issubclass(TreeFileError, ValueError)
    assert issubclass(TreeFileError, ClbvhError)


def test_a_target_that_cannot_be_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="does not exist"):
        make_tree().save(tmp_path / "gone" / "a.tree")
    with pytest.raises(ConfigError, match="this is a folder"):
        make_tree().save(tmp_path)


def test_a_failed_save_leaves_the_old_file_and_nothing_else(path, monkeypatch):
    before = path.read_bytes()

    def fail(target, write):
        def write_half(file):
            write(file)
            raise OSError("no space left on device")

        whole(target, write_half)

    whole = store.write_atomically
    monkeypatch.setattr(store, "write_atomically", fail)
    with pytest.raises(OSError, match="no space"):
        make_leaf().save(path)
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    assert path.read_bytes() == before


@pytest.mark.parametrize("path", [5, None, "a\0b"])
def test_something_that_names_no_file_is_refused(path):
    with pytest.raises(TreeFileError, match="not the path of a file"):
        Bvh.load(path, make_tree().mesh)
    with pytest.raises(ConfigError, match="not the path of a file"):
        make_tree().save(path)
