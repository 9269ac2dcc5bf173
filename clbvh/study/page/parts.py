"""The parts of a page, without their form: tables, figures, pictures and paragraphs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..statistics import Summary

# What a cell of a table can be. A summary shows its median and its range.
Cell = str | int | float | Summary | None


@dataclass(frozen=True)
class Paragraph:
    """A paragraph of plain text."""

    text: str


@dataclass(frozen=True)
class Table:
    """A table of figures.

    Attributes
    ----------
    caption : str
    columns : sequence of str
        The headings, with units.
    rows : sequence of sequence of Cell
        None where there is no figure.
    """

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]


@dataclass(frozen=True)
class Figure:
    """A drawing.

    Attributes
    ----------
    caption : str
    svg : str
        Empty where nothing can be drawn.
    """

    caption: str
    svg: str


@dataclass(frozen=True)
class Picture:
    """A rendered picture.

    Attributes
    ----------
    caption : str
    png : bytes
    """

    caption: str
    png: bytes


Part = Paragraph | Table | Figure | Picture
