"""The picture of a tree: it shows what the numbers say."""

from __future__ import annotations

import sys

import imageio.v3 as imageio
import numpy as np
import pytest

from clbvh import build, measure_tree
from clbvh.errors import ConfigError
from clbvh.stats import tree_plot

from ...soup import make_soup
from ..hand_made import make_leaf, make_tree

WIDTH, HEIGHT = 1500, 750


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """A function from statistics to the two axes and the pixels of their plot."""
    kept = []

    def draw(stats, title):
        kept.append(whole(stats, title))
        return kept[-1]

    whole = tree_plot._draw
    monkeypatch.setattr(tree_plot, "_draw", draw)

    def plot(stats, title="a tree"):
        tree_plot.write_tree_plot(tmp_path / "a.png", stats, title)
        return kept[-1], imageio.imread(tmp_path / "a.png")

    return plot


def bars_of(axes):
    """Return the middles and the heights of all bars, (n, 2)."""
    return np.array([(bar.get_x() + bar.get_width() / 2, bar.get_height()) for bar in axes.patches])


def test_bars_are_shares_of_the_leaves(drawn):
    figure, pixels = drawn(measure_tree(make_tree()))
    sizes, depths = figure.axes
    assert bars_of(sizes) == pytest.approx(np.array([(1, 2 / 3), (2, 1 / 3)]))
    assert bars_of(depths) == pytest.approx(np.array([(1, 1 / 3), (2, 2 / 3)]))
    assert [label.get_text() for label in sizes.texts] == ["67 %", "33 %"]
    assert pixels.shape[:2] == (HEIGHT, WIDTH)
    assert len(np.unique(pixels.reshape(HEIGHT * WIDTH, -1), axis=0)) > 10


def test_the_mark_is_at_the_mean(drawn):
    figure, _ = drawn(measure_tree(make_tree()))
    for axes, mean in zip(figure.axes, (4 / 3, 5 / 3), strict=True):
        assert axes.lines[0].get_xdata() == [mean]
        assert axes.get_title("left").endswith(f": mean {mean:.2f}")


def test_the_text_names_the_tree_and_its_figures(drawn):
    figure, _ = drawn(measure_tree(make_tree()), "what $it$ is")
    title, summary = (text.get_text() for text in figure.texts)
    assert title == r"what \$it\$ is"
    for word in ("triangles 4", "nodes 5", "leaves 3", "SAH cost", "EPO 0.75", "44 bytes per triangle"):
        assert word in summary
    assert "sampled" not in summary


def test_a_sample_is_called_one(drawn):
    figure, _ = drawn(measure_tree(build(make_soup(300, 1)), overlap_sample=100))
    assert "(sampled)" in figure.texts[1].get_text()


@pytest.mark.parametrize("leaf_size", [1, 4, 255])
def test_no_text_leaves_the_picture_or_touches_another(drawn, leaf_size):
    stats = measure_tree(build(make_soup(5000, 1, copies=0.2), leaf_size=leaf_size, traversal_cost=leaf_size))
    figure, _ = drawn(stats)
    texts = [*figure.texts, *(text for axes in figure.axes for text in (axes.title, axes._left_title, *axes.texts))]
    boxes = [text.get_window_extent() for text in texts if text.get_text()]
    for number, box in enumerate(boxes):
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.x1
        assert box.y0 >= 0
        assert box.y1 <= figure.bbox.y1
        assert not any(box.overlaps(other) for other in boxes[:number])


def test_a_tree_of_one_leaf_can_be_drawn(drawn):
    figure, _ = drawn(measure_tree(make_leaf()))
    assert [bars_of(axes).tolist() for axes in figure.axes] == [[[4, 1]], [[0, 1]]]


def test_other_names_and_places_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"must end in \.png"):
        tree_plot.check_plot_path(tmp_path / "a.pdf")
    with pytest.raises(ConfigError, match="does not exist"):
        tree_plot.check_plot_path(tmp_path / "gone" / "a.png")


def test_without_matplotlib_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ConfigError, match="pip install matplotlib"):
        tree_plot.check_plot_path(tmp_path / "a.png")


def test_nothing_of_matplotlib_stays_changed(drawn):
    import matplotlib

    before = {key: matplotlib.rcParams[key] for key in tree_plot._STYLE}
    assert before != tree_plot._STYLE
    drawn(measure_tree(make_tree()))
    assert {key: matplotlib.rcParams[key] for key in tree_plot._STYLE} == before
