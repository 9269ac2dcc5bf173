"""`clbvh fetch`: download known meshes, or show where they are."""

from __future__ import annotations

from typing import Annotated

import typer


def fetch(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="bunny, dragon, drill.", show_default=False)
    ] = None,
    list_all: Annotated[bool, typer.Option("--list", help="Show the known meshes and where they are.")] = False,
    base_url: Annotated[
        str | None, typer.Option(metavar="URL", help="Download from a mirror of Stanford's repository.")
    ] = None,
) -> None:
    """Download known meshes into the cache; with no name, show which there are."""
    from ..geometry.known import KNOWN_MESHES, STANFORD, get_known_mesh

    if list_all or not names:
        for name in KNOWN_MESHES:
            print(f"{name:8} {_describe_place(name)}")
        return
    # All names first: a wrong one should not be found out after a long download.
    for name in names:
        get_known_mesh(name)
    for name in names:
        print(f"{name:8} {_fetch_with_bar(name, base_url or STANFORD)}")


def _describe_place(name: str) -> str:
    from ..errors import MeshError
    from ..geometry.known import find_known_mesh

    try:
        return str(find_known_mesh(name))
    except MeshError:
        return f"not here: run 'clbvh fetch {name}'"


def _fetch_with_bar(name: str, base_url: str) -> str:
    """Fetch one mesh, with a progress bar on stderr when that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

    from ..geometry.known import fetch_mesh

    console = Console(stderr=True)
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as progress:
        return str(fetch_mesh(name, base_url=base_url, progress=_Bar(progress, name)))


class _Bar:
    """A rich progress bar with the face that pooch expects."""

    def __init__(self, progress, name: str) -> None:  # type: ignore[no-untyped-def] # rich is not imported yet
        self._progress = progress
        self._task = progress.add_task(name, total=None)

    @property
    def total(self) -> float | None:
        """Bytes in all."""
        return self._progress.tasks[0].total

    @total.setter
    def total(self, total: float) -> None:
        self._progress.update(self._task, total=total)

    def update(self, byte_count: int) -> None:
        """Move on."""
        self._progress.update(self._task, advance=byte_count)

    def reset(self) -> None:
        """Start again."""
        self._progress.update(self._task, completed=0)

    def close(self) -> None:
        """Leave the bar as it is: its owner takes it away."""
