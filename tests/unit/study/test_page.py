"""The page: complete, self-contained and escaped; its Markdown is compared with the documents in `test_study.py`."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

from clbvh.study.page import (
    HTML,
    Axis,
    Figure,
    Picture,
    Section,
    Table,
    render,
)
from clbvh.study.statistics import Summary

VOID = {"meta", "img", "br"}
NOISY, QUIET = Summary(10.0, 5.0, 20.0, 3), Summary(10.0, 9.9, 10.1, 3)


class Page(HTMLParser):
    """Checks that elements are nested, and collects attributes and words."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.addresses, self.words, self.classes = [], [], [], [], []
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
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words += data.split()


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
    assert "case ms a < b 10.0 5.00 to 20.0 c \u2013 d 1,234" in " ".join(page.words)
