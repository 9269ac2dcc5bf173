"""The tables that the verbs print, in one style."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection

    from ..builders.tree_cache import TreeOptions


def make_facts() -> Any:
    """Return an empty table of names and facts."""
    from rich.table import Table

    facts = Table(box=None, show_header=False, pad_edge=False)
    facts.add_column(style="dim")
    facts.add_column()
    return facts


def make_table(*headings: str, numbers: Collection[str] = ()) -> Any:
    """Return an empty table; the columns of some headings have numbers, which stand to the right."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim")
    for heading in headings:
        table.add_column(heading, justify="right" if heading in numbers else "left")
    return table


def make_times() -> Any:
    """Return an empty table of phases, their milliseconds, and their descriptions."""
    return make_table("phase", "ms", "", numbers=["ms"])


def add_time(times: Any, phase: str, ms: float, description: str, style: str = "") -> None:
    """Add a row to a table of `make_times`."""
    times.add_row(phase, f"{ms:,.1f}", f"[dim]{description}[/dim]", style=style)


def describe_mesh(name: str, *facts: str) -> str:
    """Return a line about a mesh; brackets in its name are no markup."""
    from rich.markup import escape

    return ", ".join([escape(name), *(fact for fact in facts if fact)])


def describe_count(count: int, noun: str) -> str:
    """Return ``1 triangle``, or ``2,000 triangles``."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def describe_scene(instances: int, geometries: int, prims: int) -> str:
    """Return ``2 instances of 1 geometry, 8,000 primitives placed``."""
    return (
        f"{describe_count(instances, 'instance')} of {geometries:,} geometr{'ies' if geometries > 1 else 'y'}, "
        f"{prims:,} primitives placed"
    )


def describe_workers(count: int) -> str:
    """Return ``1 worker``, or ``2 workers``."""
    return describe_count(count, "worker")


def describe_options(wanted: TreeOptions) -> dict[str, Any]:
    """Return the builder and its options for JSON."""
    import dataclasses

    return {"builder": wanted.builder, **dataclasses.asdict(wanted.build)}


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
