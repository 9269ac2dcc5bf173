"""Any file gives a right tree over the mesh or a `TreeFileError`; any move of the vertices leaves a right tree."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh import Bvh, build, validate_tree
from clbvh.bvh import serialize as store
from clbvh.errors import TreeFileError

from ..profiles import examples
from ..soup import make_soup

TREE = build(make_soup(12, seed=3), leaf_size=2)
HEADER_BYTES, DIGEST_AT, HEADER_DIGEST_AT = 84, 52, 68


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("trees") / "a.tree"


@pytest.fixture(scope="module")
def saved(path):
    """The bytes of the right file."""
    TREE.save(path)
    return path.read_bytes()


def load(path, content):
    """Check that a file gives a right tree or an error of one line; return whether it gave a tree."""
    path.write_bytes(content)
    try:
        bvh = Bvh.load(path, TREE.mesh)
    except TreeFileError as error:
        assert "\n" not in str(error)  # noqa: PT017 - that no other exception comes is the test
        return False
    validate_tree(bvh)
    return True


def with_right_sums(content):
    """Return a file whose digests fit its content."""
    facts = content[:DIGEST_AT] + hashlib.sha256(content[HEADER_BYTES:]).digest()[:16]
    return facts + hashlib.sha256(facts).digest()[:16] + content[HEADER_BYTES:]


@examples(short=300, long=10000)
@given(content=st.binary(max_size=400), has_magic=st.booleans())
def test_random_bytes_are_no_tree(path, content, has_magic):
    assert not load(path, store.MAGIC * has_magic + content)


@examples(short=300, long=10000)
@given(cuts=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 12), st.binary(max_size=6)), min_size=1, max_size=3))
def test_a_damaged_file_is_no_tree(path, saved, cuts):
    content = saved
    for share, length, piece in cuts:
        at = int(share * len(content))
        content = content[:at] + piece + content[at + length :]
    assert load(path, content) == (content == saved)


def words_of(content):
    return np.frombuffer(content[HEADER_BYTES:], "<i4").copy()


WORDS = st.one_of(st.integers(-2, 25), st.sampled_from([-(2**31), 2**31 - 1, 2**30, -(2**30)]))


@examples(short=500, long=20000)
@given(changes=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), WORDS), min_size=1, max_size=6))
def test_forged_links_give_a_right_tree_or_none(path, saved, changes):
    words = words_of(saved)
    for share, word in changes:
        words[int(share * len(words))] = word
    load(path, with_right_sums(saved[:HEADER_BYTES] + words.tobytes()))


@examples(short=200, long=10000)
@given(seed=st.integers(0, 2**32 - 1))
def test_another_order_of_the_same_numbers_gives_a_right_tree_or_none(path, saved, seed):
    """Links and triangles that are all in range, and mostly in the wrong order."""
    random = np.random.default_rng(seed)
    words = words_of(saved)
    node_count = TREE.node_count
    for begin, end in ((0, node_count), (node_count, 2 * node_count), (2 * node_count, len(words))):
        pair = random.choice(np.arange(begin, end), 2, replace=False)
        words[pair] = words[pair[::-1]]
    load(path, with_right_sums(saved[:HEADER_BYTES] + words.tobytes()))


@examples(short=50, long=2000)
@given(seed=st.integers(0, 2**32 - 1))
def test_another_order_of_the_triangles_gives_another_right_tree(path, saved, seed):
    words = words_of(saved)
    words[2 * TREE.node_count :] = np.random.default_rng(seed).permutation(TREE.mesh.face_count)
    assert load(path, with_right_sums(saved[:HEADER_BYTES] + words.tobytes()))


SOUPS = st.builds(
    make_soup,
    count=st.integers(1, 400),
    seed=st.integers(0, 2**32 - 1),
    grid=st.sampled_from([0, 1, 30, 1000]),
    size=st.sampled_from([0, 1, 20, 1000]),
    copies=st.sampled_from([0.0, 0.5]),
    degenerate=st.sampled_from([0.0, 0.5, 1.0]),
    scale=st.sampled_from([1.0, 1e-30, 1e30, -0.1]),
)


@examples(short=50, long=1000)
@given(mesh=SOUPS, leaf_size=st.sampled_from([1, 4, 255]))
def test_any_tree_comes_back_from_its_file(path, mesh, leaf_size):
    bvh = build(mesh, leaf_size=leaf_size)
    bvh.save(path)
    loaded = Bvh.load(path, mesh)
    assert loaded.nodes.tobytes() == bvh.nodes.tobytes()
    assert loaded.prim_ids.tobytes() == bvh.prim_ids.tobytes()


@examples(short=100, long=2000)
@given(mesh=SOUPS, seed=st.integers(0, 2**32 - 1), grid=st.sampled_from([0, 1, 1000]), scale=st.sampled_from([1, 1e30]))
def test_any_move_leaves_a_right_tree(mesh, seed, grid, scale):
    bvh = build(mesh)
    vertices = np.random.default_rng(seed).integers(-grid, grid, mesh.vertices.shape, endpoint=True) * scale
    moved = bvh.refit(vertices)
    validate_tree(moved)
    assert (moved.nodes["count"] == bvh.nodes["count"]).all()
