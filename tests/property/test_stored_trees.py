"""Any damaged file is no tree (forged ones: `make fuzz`); any tree comes back, and any move leaves a right tree."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh import Bvh, TreeFileError, build, validate_tree

from ..profiles import examples
from ..soup import make_soup
from .test_builds import SOUPS

SHARES = st.floats(0, 1, exclude_max=True)


@pytest.fixture(scope="module")
def tree():
    return build(make_soup(12, seed=3), leaf_size=2)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("trees") / "a.tree"


@pytest.fixture(scope="module")
def saved(tree, path):
    """The bytes of the right file."""
    tree.save(path)
    return path.read_bytes()


@pytest.fixture(scope="module")
def load(tree, path):
    """A function that checks that a file gives a right tree or an error of one line, and tells which."""

    def run(content):
        path.write_bytes(content)
        try:
            bvh = Bvh.load(path, tree.mesh)
        except TreeFileError as error:
            assert "\n" not in str(error)  # noqa: PT017 - that no other exception comes is the test
            return False
        validate_tree(bvh)
        return True

    return run


@examples(short=60, long=20000)
@given(
    cuts=st.lists(st.tuples(SHARES, st.integers(0, 12), st.binary(max_size=6)), min_size=1, max_size=3),
    end=st.sampled_from([1.0, 1.0]) | SHARES,
)
def test_a_damaged_or_cut_file_is_no_tree(load, saved, cuts, end):
    content = saved
    for share, length, piece in cuts:
        at = int(share * len(content))
        content = content[:at] + piece + content[at + length :]
    content = content[: int(end * len(content))]
    assert load(content) == (content == saved)


@examples(short=30, long=2000)
@given(
    mesh=SOUPS, leaf_size=st.sampled_from([1, 4, 255]), seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0, 1e30])
)
def test_any_tree_comes_back_from_its_file_and_any_move_leaves_it_right(path, mesh, leaf_size, seed, size):
    bvh = build(mesh, leaf_size=leaf_size)
    bvh.save(path)
    loaded = Bvh.load(path, mesh)
    assert loaded.nodes.tobytes() == bvh.nodes.tobytes()
    assert loaded.prim_ids.tobytes() == bvh.prim_ids.tobytes()
    moved = bvh.refit(np.random.default_rng(seed).integers(-9, 9, mesh.vertices.shape, endpoint=True) * size)
    validate_tree(moved)
    assert (moved.nodes["count"] == bvh.nodes["count"]).all()
