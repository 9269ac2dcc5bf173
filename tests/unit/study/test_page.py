"""The page: complete, self-contained and escaped; figures, and Markdown."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

from clbvh.study.page import (
    HTML,
    RESULTS,
    Axis,
    Figure,
    Picture,
    Section,
    Table,
    format_cell,
    format_number,
    render,
)
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


def test_a_page_is_escaped_holds_its_pictures_and_shows_median_and_range():
    parts = [
        "<script>alert()</script>",
        Table("Times.", ("case", "ms"), [("a < b", NOISY), ("c", None), ("d", 1234)]),
        Picture("A & B.", b"\x89PNG"),
        Figure("Bars.", [("ours", "a", QUIET), ("ours", "b", None)], Axis("B & C")),
    ]
    text = render(
        HTML, machine={"cores": "2"}, sections=[Section("one", "One", "Why?", "", parts, ["a & b < c"])],
        notes=["First & <last>."], rounds="all rounds", size="tiny", samples="a", table="b",
    )  # fmt: skip
    assert "<script>" not in text
    assert "a &amp; b &lt; c" in text
    page = check_self_contained(text)
    picture, figure = (address for address in page.addresses if address.startswith("data:"))
    assert picture == "data:image/png;base64,iVBORw=="
    drawn = base64.b64decode(figure.partition(",")[2])
    assert b"<svg" in drawn
    assert b">B &amp; C<" in drawn
    assert "warn" in page.classes  # of noise
    (table,) = page.tables
    assert [[" ".join(cell.split()) for cell in row] for row in table] == [
        ["case", "ms"], ["a < b", "10.0 5.00 to 20.0"], ["c", "\u2013"], ["d", "1,234"],
    ]  # fmt: skip


def test_markdown_has_medians_texts_and_links_to_figures():
    figure = Figure("Bars.", [("ours", "a", QUIET)], Axis("ms"))
    section = Section(
        "one", "One", "Why?", "By hand.", [Table("All.", ("a|b", "ms"), [("x", QUIET)]), figure], ["Noise."]
    )
    text = render(
        RESULTS, machine={"cores": "2"}, sections=[section], folder="results", size="tiny",
        name_figure=lambda section, number: f"{section.name}-{number}.svg",
    )  # fmt: skip
    head = "| machine |  |\n|---|---|\n| cores | 2 |\n\n## One\n\nWhy?\n\nBy hand.\n\nAll.\n\n"
    table, plot = "| a/b | ms |\n|---|---|\n| x | 10.0 |", "![One, plot](results/one-2.svg)\n\nBars."
    assert text.endswith(f"{head}{table}\n\n{plot}\n\nNoise.\n")


def test_numbers_have_three_digits():
    for value, text in (
        (0.0, "0"), (0.012345, "0.0123"), (99.96, "100.0"), (1234.6, "1,235"), (1234567, "1,234,567"),
        (float("nan"), "\u2013"), (-2.5, "-2.50"),
    ):  # fmt: skip
        assert format_number(value) == text
    assert format_cell(NOISY) == "10.0 (5.00 to 20.0)"
    assert format_cell(Summary(10.0, 10.0, 10.0, 1)) == "10.0"
