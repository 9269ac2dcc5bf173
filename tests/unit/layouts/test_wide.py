"""Wide trees are made by any number of threads, whose work depends on nothing but the tree."""

from itertools import pairwise
from unittest.mock import Mock

import numpy as np
import pytest

from clbvh import Spheres, build
from clbvh.builders.build import build_shape
from clbvh.geometry import joined_shapes
from clbvh.layouts import device_arrays, wide
from clbvh.support.host_threads import HostThreads
from clbvh.tree_layouts import LAYOUTS, TREE_LAYOUTS

from ...chain import make_chain
from ...soup import make_soup


def bytes_of(tree):
    return tree.nodes.tobytes(), tree.blocks.tobytes(), tree.stack_size


@pytest.mark.parametrize("width", [4, 8])
def test_any_number_of_threads_makes_the_same_bytes(width, monkeypatch):
    monkeypatch.setattr(wide, "_LEAST_NODES", 16)
    # Leaves of 30 triangles are split, so that the order of nodes is not depth-first.
    soups = [make_soup(count, count, grid=30, size=4, copies=0.2) for count in (9, 100, 3000)]
    trees = [build(soup, leaf_size=size) for soup in soups for size in (1, 4, 30)]
    for bvh in (*trees, make_chain(500, "left")[1], make_chain(500, "right")[1]):
        with HostThreads(1) as threads:
            monkeypatch.setattr(wide, "_SUBTREES_OF_THREAD", 1)
            expected = bytes_of(wide.widen(bvh, width, threads))
        monkeypatch.setattr(wide, "_SUBTREES_OF_THREAD", 16)
        for count in (1, 2, 7):
            with HostThreads(count) as threads:
                for _ in range(3):
                    assert bytes_of(wide.widen(bvh, width, threads)) == expected


@pytest.mark.parametrize("layout", TREE_LAYOUTS)
def test_small_trees_get_the_same_arrays_together(layout, monkeypatch):
    monkeypatch.setattr(joined_shapes, "_LEAST_SHAPES", 2)
    random = np.random.default_rng(5)
    soups = [make_soup(count, count, grid=30, size=4, copies=0.2, degenerate=0.1) for count in (1, 9, 100, 5000)]
    balls = [Spheres(random.normal(size=(count, 3)), random.uniform(0, 0.1, count)) for count in (1, 300, 20)]
    bvhs = [build(soup, leaf_size=size) for soup in soups for size in (1, 4, 30)]
    bvhs += [build_shape(ball, "default") for ball in balls]
    bvhs.insert(3, make_chain(500, "left")[1])

    def bytes_of_arrays(arrays):
        blocks = np.zeros(arrays.blocks.item_count, arrays.blocks.struct)
        with HostThreads() as threads:
            arrays.blocks.write(blocks, threads)
        return arrays.nodes.tobytes(), blocks.tobytes(), arrays.stack_size

    expected = [bytes_of_arrays(device_arrays.make_device_arrays(bvh, layout)) for bvh in bvhs]
    assert list(map(bytes_of_arrays, device_arrays.make_all_arrays(bvhs, layout))) == expected
    if LAYOUTS[layout].is_wide:
        alone = Mock()
        monkeypatch.setattr(device_arrays, "make_device_arrays", alone)
        device_arrays.make_all_arrays(bvhs, layout)
        assert [call.args[0] for call in alone.call_args_list] == [bvh for bvh in bvhs if len(bvh.prim_ids) == 5000]


def test_subtrees_across_the_ends_of_ranges_come_last():
    bvh = build(make_soup(2000, 1, grid=30, size=4), leaf_size=2)
    with HostThreads(1) as threads:
        expected = bytes_of(wide.widen(bvh, 8, threads))

    class OneAfterTheOther(HostThreads):
        def for_ranges(self, item_count, task, *, least_items=0):
            bounds = np.linspace(0, item_count, 40).astype(int).tolist()
            for begin, end in pairwise(bounds):
                task(begin, end)

    with OneAfterTheOther(1) as threads:
        assert bytes_of(wide.widen(bvh, 8, threads)) == expected
