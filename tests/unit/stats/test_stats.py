"""What a tree consists of and how good it is, against numbers worked out by hand, and the picture that shows it."""

from __future__ import annotations

import json
import sys

import imageio.v3 as imageio
import numpy as np
import pytest

from clbvh import ConfigError, Mesh, build, measure_tree, sah_cost
from clbvh.stats import tree_plot
from clbvh.stats.overlap import measure_overlap
from clbvh.stats.tree_stats import Bar, gather_bars

from ..hand_made import make_leaf, make_tree

# Half areas of the hand-made tree's boxes, from their sizes: xy + yz + zx.
ROOT = 7 * 1 + 1 * 3 + 3 * 7
NODE_1 = NODE_2 = 5 * 1 + 1 * 2 + 2 * 5
FLAT = 1 * 1


def test_cost_of_the_hand_made_tree():
    for traversal, intersection in ((1.0, 1.0), (3.0, 1.0), (1.0, 3.0), (0.0, 2.0), (8.0, 0.0)):
        expected = traversal * (ROOT + NODE_2) + intersection * (2 * NODE_1 + FLAT + FLAT)
        cost = sah_cost(make_tree(), traversal_cost=traversal, intersection_cost=intersection)
        assert cost == pytest.approx(expected / ROOT, rel=1e-15)
    assert sah_cost(make_leaf(4), intersection_cost=2.5) == 10
    point = build(Mesh.from_arrays(np.ones((3, 3)), np.tile([0, 1, 2], (8, 1))), leaf_size=2)
    assert sah_cost(point) == 8 + (point.nodes["count"] > 0).sum() - 1  # everything


def test_stats_of_the_hand_made_tree():
    stats = measure_tree(make_tree(), traversal_cost=3, intersection_cost=0.5)
    assert (stats.triangle_count, stats.node_count, stats.interior_count, stats.leaf_count) == (4, 5, 2, 3)
    assert (stats.depth, stats.mean_leaf_depth, stats.mean_leaf_size) == (2, 5 / 3, 4 / 3)
    assert (stats.leaf_sizes, stats.leaf_depths) == ((0, 2, 1), (0, 1, 2))
    assert (stats.traversal_cost, stats.intersection_cost) == (3, 0.5)
    assert stats.sah_cost == sah_cost(make_tree(), traversal_cost=3, intersection_cost=0.5)
    assert stats.epo == measure_overlap(make_tree(), traversal_cost=3, intersection_cost=0.5).epo != 0
    assert (stats.epo_triangles, stats.host_bytes, stats.host_bytes_per_triangle) == (4, 5 * 32 + 4 * 4, 44)
    # Four triangles are one block.
    assert stats.device_bytes == {"bvh2": 2 * 64 + 4 * 40, "bvh4": 112 + 160, "bvh8": 224 + 320, "bvh8c": 224 + 240}
    assert json.loads(json.dumps(stats.as_dict()))["device_bytes_per_triangle"] == {
        "bvh2": 72,
        "bvh4": 68,
        "bvh8": 136,
        "bvh8c": 116,
    }


def test_bars_fit_and_lose_nothing():
    assert gather_bars([0, 5, 0, 2, 0], 3) == [Bar(1, 1, 5), Bar(2, 2, 0), Bar(3, 3, 2)]
    assert gather_bars([], 5) == gather_bars([0, 0], 5) == []
    for most in (1, 7, 99, 100):
        bars = gather_bars([0, *range(1, 101)], most)
        assert (len(bars) <= most, sum(bar.count for bar in bars)) == (True, 5050)
        assert [bar.first for bar in bars] == [1, *(bar.last + 1 for bar in bars[:-1])]
    assert (Bar(3, 3, 1).label, Bar(3, 5, 1).label) == ("3", "3 to 5")


def test_the_picture_shows_what_the_numbers_say(monkeypatch, tmp_path):
    figures, draw = [], tree_plot._draw
    monkeypatch.setattr(tree_plot, "_draw", lambda *arguments: figures.append(draw(*arguments)) or figures[-1])
    tree_plot.write_tree_plot(tmp_path / "a.png", measure_tree(make_tree()), "what $it$ is")
    sizes, depths = figures[0].axes
    for axes, heights in ((sizes, [2 / 3, 1 / 3]), (depths, [1 / 3, 2 / 3])):
        assert [bar.get_x() + bar.get_width() / 2 for bar in axes.patches] == pytest.approx([1, 2])
        assert [bar.get_height() for bar in axes.patches] == pytest.approx(heights)
    assert [label.get_text() for label in sizes.texts] == ["67 %", "33 %"]
    assert [axes.lines[0].get_xdata()[0] for axes in (sizes, depths)] == [4 / 3, 5 / 3]
    title, summary = (text.get_text() for text in figures[0].texts)
    assert title == r"what \$it\$ is"
    for word in ("triangles 4", "nodes 5", "leaves 3", "SAH cost", "EPO 0.75", "44 bytes per triangle"):
        assert word in summary
    assert imageio.imread(tmp_path / "a.png").shape[:2] == (750, 1500)


def test_other_names_and_places_and_a_missing_matplotlib_are_refused(tmp_path, monkeypatch):
    for path, words in ((tmp_path / "a.pdf", r"must end in \.png"), (tmp_path / "gone" / "a.png", "does not exist")):
        with pytest.raises(ConfigError, match=words):
            tree_plot.check_plot_path(path)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ConfigError, match="clbvh\\[study\\]"):
        tree_plot.check_plot_path(tmp_path / "a.png")
