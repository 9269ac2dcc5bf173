"""Trees in files: a saved tree comes back, and every other content is refused in one sentence."""

import hashlib
import struct

import numpy as np
import pytest

from clbvh import Bvh, ConfigError, Mesh, TreeFileError, build

from ...rays import mesh_as_on_device
from ...soup import make_soup
from ..hand_made import make_leaf, make_tree

VERSION_AT, HEADER_BYTES = 8, 84

RIGHT_LINKS = [(1, 0), (0, 2), (3, 0), (2, 1), (3, 1)]
RIGHT_PRIMS = [0, 2, 3, 1]


@pytest.fixture
def path(tmp_path):
    """The file of the hand-made tree."""
    path = tmp_path / "a.tree"
    make_tree().save(path)
    return path


def forge(path, links, prim_ids, *, node_count=None):
    """Write a file whose sums are right, whatever its links are: (first, count) of each node."""
    payload = np.concatenate([np.array(links, "<i4").reshape(-1, 2).T.ravel(), np.array(prim_ids, "<i4")]).tobytes()
    facts = struct.pack("<8sIII", b"\x8bBVH\r\n\x1a\n", 2, node_count or len(links), len(prim_ids))
    facts += make_tree().mesh.fingerprint + hashlib.sha256(payload).digest()[:16]
    path.write_bytes(facts + hashlib.sha256(facts).digest()[:16] + payload)


def refused(path, mesh=None):
    """Return the one short sentence with which a file is refused."""
    with pytest.raises(TreeFileError) as caught:
        Bvh.load(path, mesh or make_tree().mesh)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert len(message) < 500 + len(str(path))
    return message


def test_a_mesh_may_be_elsewhere_and_in_another_unit_but_no_other_mesh(path, tmp_path):
    bvh = build(make_soup(300, 1))
    bvh.save(tmp_path / "tree")
    moved = Mesh.from_arrays(bvh.mesh.vertices * 2.0**-70 + [0, 2.0**-60, 0], bvh.mesh.faces)
    loaded = Bvh.load(str(tmp_path / "tree"), moved)
    assert loaded.nodes.tobytes() == bvh.nodes.tobytes()
    assert loaded.nodes.flags.writeable
    assert loaded.mesh is moved
    mesh = make_tree().mesh
    for other in (
        mesh_as_on_device(mesh.local_vertices * [1, 1, 2], mesh.faces, "other"),
        mesh_as_on_device(mesh.local_vertices, mesh.faces[::-1], "other"),
        make_leaf(3).mesh,
    ):
        assert f"another mesh than {other.name}" in refused(path, other)


def test_what_has_changed_is_said(path):
    """That every changed byte and every cut is noticed is a property."""
    right = path.read_bytes()
    damaged = "damaged or was cut off"
    wrong = {0: "not a saved tree", VERSION_AT: "in format 3", HEADER_BYTES: damaged, len(right) - 1: damaged}
    for at, words in wrong.items():
        path.write_bytes(right[:at] + bytes([right[at] ^ 1]) + right[at + 1 :])
        assert words in refused(path), at
        path.write_bytes(right[:at])
        assert (damaged if at else "not a saved tree") in refused(path), at


def test_links_that_make_no_tree_are_refused(path):
    right = path.read_bytes()
    forge(path, RIGHT_LINKS, RIGHT_PRIMS)
    assert path.read_bytes() == right  # so that what follows is about the links and not about the forging
    for count in (2, 7, 2**32 - 1):  # allocates nothing
        forge(path, RIGHT_LINKS, RIGHT_PRIMS, node_count=count)
        assert "damaged" in refused(path), count
    for links, prim_ids in (([], RIGHT_PRIMS), (RIGHT_LINKS, range(3)), (RIGHT_LINKS, range(5))):
        forge(path, links, prim_ids)
        assert "damaged" in refused(path)
    for what, links, prim_ids in [
        ("a child above its parent", [*RIGHT_LINKS[:2], (1, 0), *RIGHT_LINKS[3:]], RIGHT_PRIMS),
        ("a circle that nothing reaches", [(1, 0), (0, 2), (2, 1), (3, 0), (3, 1)], RIGHT_PRIMS),
        ("the lowest count", [(1, 0), (0, -(2**31)), *RIGHT_LINKS[2:]], RIGHT_PRIMS),
        ("a slot in no leaf", [(1, 0), (0, 1), *RIGHT_LINKS[2:]], RIGHT_PRIMS),
        ("a negative triangle, the last one from behind", RIGHT_LINKS, [0, 2, -1, 1]),
    ]:
        forge(path, links, prim_ids)
        assert "its nodes make no tree" in refused(path), what


def test_what_is_no_file_of_a_tree_is_refused(tmp_path):
    assert "no such file" in refused(tmp_path / "gone.tree")
    assert "cannot be read" in refused(tmp_path)
    for content in (b"", b"ply\n", bytes(1000), b"\x8bBVH\n\x1a\n" + bytes(200)):
        (tmp_path / "a.tree").write_bytes(content)
        assert "not a saved tree" in refused(tmp_path / "a.tree")
    for path, message in ((tmp_path / "gone" / "a.tree", "does not exist"), (tmp_path, "this is a folder")):
        with pytest.raises(ConfigError, match=message):
            make_tree().save(path)
    with pytest.raises(TreeFileError, match="not the path of a file"):
        Bvh.load("a\0b", make_tree().mesh)
