"""The reports of the verbs: as JSON, or as tables of one style."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

# Of the rows in tables of times, whatever the verb.
_PHASES = {
    "start": "start Python, and load the program",
    "load": "load and place the objects",
    "cache": "look the tree up in the cache, or keep it there",
    "build": "build the tree",
    "validate": "check the tree",
    "measure": "the measures above",
    "rays": "cast on the device, as layout bvh2",
    "open": "open the device",
    "layout": "arrange the tree for the device",
    "compile": "compile kernels in a first run, or load them",
    "upload": "host to device, by the device's clock",
    "kernel": "trace and shade, by the device's clock",
    "download": "device to host, by the device's clock",
    "other": "whatever lies between the phases",
    "total": "wall time, from the start of the command",
    "write": "write the picture or heat map",
}


def print_json(report: dict[str, Any]) -> None:
    """Print a report as one JSON object; what JSON does not know is written as text."""
    print(json.dumps(report, indent=2, default=str))


def print_report(report: dict[str, Any], *shown: Any, as_json: bool, notes: Iterable[str] = ()) -> None:
    """Print a report: as one JSON object, or as the tables and lines that are shown to readers; and then notes."""
    if as_json:
        print_json(report)
    else:
        print_tables(*shown)
    print_notes(notes)


def print_tables(*shown: Any) -> None:
    """Print tables and lines to stdout, separated by empty lines: at once, so that Ctrl-C leaves all or none."""
    from rich.console import Console, Group
    from rich.text import Text

    parts = (part for each in shown for part in ("", Text(each) if isinstance(each, str) else each))
    Console(highlight=False, soft_wrap=True, file=sys.stdout).print(Group(*[*parts][1:]))


def print_notes(notes: Iterable[str]) -> None:
    """Print sentences for the user on stderr, each as one line."""
    for note in notes:
        print(f"clbvh: {note}", file=sys.stderr)


def make_facts(facts: Mapping[str, str]) -> Any:
    """Return a table of names and facts, without those that are empty; brackets in them are no markup."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim")
    # A long path is broken, not cut off.
    table.add_column(overflow="fold")
    for name, fact in facts.items():
        if fact:
            table.add_row(name, escape(fact))
    return table


def make_table(headings: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Sequence[str] = ()) -> Any:
    """Return a table; the columns of some headings have numbers, which stand to the right.

    The row of the total is bold, and one that begins with a star.
    """
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim")
    for heading in headings:
        table.add_column(heading, justify="right" if heading in numbers else "left")
    for row in rows:
        table.add_row(*row, style="bold" if row[0] == "total" or row[0].startswith("*") else "")
    return table


def make_times(phases_ms: Iterable[tuple[str, float]]) -> Any:
    """Return a table of phases, their milliseconds, and their descriptions."""
    rows = ((phase, f"{ms:,.1f}", f"[dim]{_PHASES.get(phase, '')}[/dim]") for phase, ms in phases_ms)
    return make_table(("phase", "ms", ""), rows, numbers=["ms"])


def join_facts(*facts: str) -> str:
    """Return a line of facts, without those that are empty."""
    return ", ".join(filter(None, facts))


def describe_count(count: int, noun: str) -> str:
    """Return ``1 triangle``, or ``2,000 triangles``."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def describe_workers(workers: int) -> str:
    """Return ``2 workers``; without any, a device has built."""
    return describe_count(workers, "worker") if workers else "built on the device"


def describe_scene(instances: int, geometries: int, prims: int) -> str:
    """Return ``2 instances of 1 geometry, 8,000 primitives placed``."""
    kinds = f"{geometries:,} geometr{'ies' if geometries > 1 else 'y'}"
    return f"{describe_count(instances, 'instance')} of {kinds}, {prims:,} primitives placed"
