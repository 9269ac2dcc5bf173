"""`clbvh fetch`: download the well-known meshes, or show their paths."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Annotated, Any

from cyclopts import Parameter


def fetch(
    *names: Annotated[str, Parameter(name="NAME")],
    show_list: Annotated[bool, Parameter(name="--list")] = False,
    base_url: Annotated[str | None, Parameter(metavar="URL")] = None,
) -> None:
    """Download known meshes into the cache unless they are on this machine; without a name, list them.

    Parameters
    ----------
    names
        bunny, dragon, drill.
    show_list
        List the known meshes and their paths.
    base_url
        Download from a mirror of Stanford's repository.
    """
    from ..geometry.fetch import KNOWN_MESHES, STANFORD, get_known_mesh

    if show_list or not names:
        for name in KNOWN_MESHES:
            print(f"{name:8} {_describe_path(name)}")
        return
    # All names are checked first: a wrong one should not be found after a long download.
    for name in names:
        get_known_mesh(name)
    for name in names:
        print(f"{name:8} {_fetch_with_bar(name, base_url or STANFORD)}")


def _describe_path(name: str) -> str:
    from ..errors import MeshError
    from ..geometry.fetch import find_known_mesh

    try:
        return str(find_known_mesh(name))
    except MeshError:
        return f"not on this machine: run 'clbvh fetch {name}'"


def _fetch_with_bar(name: str, base_url: str) -> str:
    """Fetch one mesh, with a progress bar if stderr is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

    from ..geometry.fetch import fetch_mesh

    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(name, total=None)
        # What pooch calls; it sets the total.
        bar: Any = SimpleNamespace(
            total=None,
            update=lambda count: progress.update(task, advance=count, total=bar.total),
            reset=lambda: progress.reset(task),
            close=lambda: None,
        )
        return str(fetch_mesh(name, base_url=base_url, progress=bar))
