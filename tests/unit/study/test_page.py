"""The page: complete, self-contained, escaped, and the same with and without matplotlib."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import pytest

from clbvh.study.page import drawing
from clbvh.study.page.drawing import Axis, Series, draw_bars, draw_curves, use_page_colours
from clbvh.study.page.html import Section, write_page
from clbvh.study.page.numbers import format_cell, format_number
from clbvh.study.page.parts import Figure, Paragraph, Picture, Table
from clbvh.study.statistics import Summary

VOID = {"meta", "img", "br"}
NOISY, QUIET = Summary(10.0, 5.0, 20.0, 3), Summary(10.0, 9.9, 10.1, 3)


class Page(HTMLParser):
    """Checks that elements are nested, and collects attributes, tables and text."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.addresses, self.tables, self.classes = [], [], [], [], []
        self.tags = set()
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        names = dict(attributes)
        self.tags.add(tag)
        self.ids += [names["id"]] if "id" in names else []
        self.classes += (names.get("class") or "").split()
        self.addresses += [names[name] for name in ("href", "src", "xlink:href", "srcset", "data") if name in names]
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if {"td", "th"} & set(self.open[-3:]):
            self.tables[-1][-1][-1] += data + " "


def check_self_contained(text):
    """Return the parsed page, after checking that nothing outside of it is needed."""
    page = Page(text)
    assert not {"script", "link", "iframe"} & page.tags
    for address in page.addresses:
        assert address.startswith(("#", "data:image/")), address
    targets = {address[1:] for address in page.addresses if address.startswith("#")}
    assert targets <= set(page.ids)
    # Base64 has slashes.
    assert re.search(r"(https?:)?//\w|@import|url\((?!#)", re.sub(r"data:image/[^\"]*", "", text)) is None
    return page


def make_page(*parts, **fields):
    section = Section(**{"name": "one", "title": "One", "question": "Why?", "method": "", "parts": parts, **fields})
    return write_page("A <study>", ["First & last."], {"cores": "2"}, [section])


def test_tables_show_median_and_range():
    page = check_self_contained(
        make_page(Table("Times.", ("case", "ms"), [("a < b", NOISY), ("c", None), ("d", 1234)]))
    )
    (table,) = page.tables
    assert [[" ".join(cell.split()) for cell in row] for row in table] == [
        ["case", "ms"], ["a < b", "10.0 5.00 to 20.0"], ["c", "\u2013"], ["d", "1,234"],
    ]  # fmt: skip


def test_noise_is_marked():
    assert "warn" in Page(make_page(Table("Times.", ("ms",), [(NOISY,)]))).classes
    assert "warn" not in Page(make_page(Table("Times.", ("ms",), [(QUIET,)]))).classes


def test_text_is_escaped():
    text = make_page(Paragraph("<script>alert()</script>"), notes=["a & b < c"])
    assert "<script>" not in text
    assert "a &amp; b &lt; c" in text


def test_pictures_are_inside():
    page = check_self_contained(make_page(Picture("A & B.", b"\x89PNG")))
    assert page.addresses[-1] == "data:image/png;base64,iVBORw=="


def test_figures_are_inside_and_take_the_pages_colours():
    pytest.importorskip("matplotlib")
    curves = draw_curves(
        Axis("workers", is_log=True, ticks=(1, 2)), Axis("speed-up"),
        [Series("ours", (1, 2), (QUIET, NOISY)), Series("report", (1, 2), (1.0, 2.0), is_published=True)],
    )  # fmt: skip
    bars = draw_bars(Axis("ms", is_log=True), ["a", "b"], [Series("ours", (0, 1), (QUIET, NOISY))])
    text = make_page(Figure("Curves.", curves), Figure("Bars.", bars))
    page = check_self_contained(text)
    assert "svg" in page.tags
    for colour in ("currentColor", "var(--series-0)", "var(--published)"):
        assert colour in text
    assert "#0102" not in text
    # The same name twice would make one figure draw with the other's marks.
    assert len(set(page.ids)) == len(page.ids)
    for label in ("workers", "speed-up", "ours", "report", "ms"):
        assert label in text


def test_there_is_no_figure_without_matplotlib(monkeypatch):
    monkeypatch.setattr(drawing, "can_draw", lambda: False)
    svg = draw_bars(Axis("ms"), ["a"], [Series("ours", (0,), (QUIET,))])
    assert svg == draw_curves(Axis("x"), Axis("y"), [Series("ours", (0,), (QUIET,))]) == ""
    assert "figure" not in check_self_contained(make_page(Figure("Bars.", svg))).tags


def test_no_figure_of_nothing():
    assert draw_curves(Axis("x"), Axis("y"), [Series("ours", (), ())]) == ""


def test_names_in_a_figure_are_its_own():
    svg = '<svg><path id="m1"/><use xlink:href="#m1"/><g clip-path="url(#p2)"/></svg>'
    assert use_page_colours(svg, "ladder-1") == (
        '<svg><path id="ladder-1-m1"/><use xlink:href="#ladder-1-m1"/><g clip-path="url(#ladder-1-p2)"/></svg>'
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.012345, "0.0123"), (1.0, "1.00"), (12.345, "12.3"), (99.96, "100.0"), (1234.6, "1,235"),
     (12, "12"), (1234567, "1,234,567"), (float("nan"), "\u2013"), (float("inf"), "\u2013"), (-2.5, "-2.50")],
)  # fmt: skip
def test_numbers_have_three_digits(value, text):
    assert format_number(value) == text


def test_cells_in_plain_text():
    assert format_cell(NOISY) == "10.0 (5.00 to 20.0)"
    assert format_cell(Summary(10.0, 10.0, 10.0, 1)) == "10.0"
    assert format_cell("text") == "text"
