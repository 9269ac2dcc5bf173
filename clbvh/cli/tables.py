"""The reports of the verbs, as tables of one style or as JSON."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping


def print_json(report: dict[str, Any]) -> None:
    """Print a report as one JSON object; what JSON does not know is written as text."""
    print(json.dumps(report, indent=2, default=str))


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
    table.add_column()
    for name, fact in facts.items():
        if fact:
            table.add_row(name, escape(fact))
    return table


def make_table(*headings: str, numbers: Collection[str] = ()) -> Any:
    """Return an empty table; the columns of some headings have numbers, which stand to the right."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim")
    for heading in headings:
        table.add_column(heading, justify="right" if heading in numbers else "left")
    return table


def make_times(rows: Iterable[tuple[str, float, str]]) -> Any:
    """Return a table of phases, their milliseconds, and their descriptions; the total is bold."""
    times = make_table("phase", "ms", "", numbers=["ms"])
    for phase, ms, description in rows:
        times.add_row(phase, f"{ms:,.1f}", f"[dim]{description}[/dim]", style="bold" if phase == "total" else "")
    return times


def join_facts(*facts: str) -> str:
    """Return a line of facts, without those that are empty."""
    return ", ".join(filter(None, facts))


def describe_count(count: int, noun: str) -> str:
    """Return ``1 triangle``, or ``2,000 triangles``."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def describe_scene(instances: int, geometries: int, prims: int) -> str:
    """Return ``2 instances of 1 geometry, 8,000 primitives placed``."""
    return (
        f"{describe_count(instances, 'instance')} of {geometries:,} geometr{'ies' if geometries > 1 else 'y'}, "
        f"{prims:,} primitives placed"
    )


def print_tables(*tables: Any) -> None:
    """Print tables to stdout, separated by empty lines: all at once, so that Ctrl-C leaves all of them or none."""
    from rich.console import Console, Group

    separated = [part for table in tables for part in ("", table)][1:]
    Console(highlight=False, soft_wrap=True, file=sys.stdout).print(Group(*separated))


def choose_sign(sign: str, plain: str) -> str:
    """Return `sign` if stdout can show it, else `plain`."""
    try:
        sign.encode(sys.stdout.encoding or "ascii")
    except UnicodeEncodeError:
        return plain
    return sign
