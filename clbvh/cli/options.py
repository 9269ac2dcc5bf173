"""Options that several verbs share: each is defined once, and means the same everywhere."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ..builders.options import BuildOptions
    from ..rendering.scene import Scene

TREE_PANEL = "Tree"
DEVICE_PANEL = "Device"

# The defaults of `clbvh.BuildOptions`, repeated because importing them would make `clbvh --help` slow. A test compares
# them.
DEFAULT_BUILDER = "sah"
DEFAULT_LEAF_SIZE = 4
DEFAULT_TRAVERSAL_COST = 1.0
DEFAULT_FRONTIER = 64
DEFAULT_QUALITY = "default"

_SOURCE_HELP = (
    "A mesh file (PLY, OBJ, STL, OFF, GLB, glTF), a scene file (.toml), or a shipped scene: "
    "demo, bunny, cornell, dragon, drill, galaxy, hall, knot, meadow, palace, still-life, terrain, weekend."
)

Source = Annotated[str, typer.Argument(metavar="MESH|SCENE", help=_SOURCE_HELP, show_default=False)]
Sources = Annotated[
    list[str],
    typer.Argument(
        metavar="MESH|SCENE",
        help=f"{_SOURCE_HELP} Several mesh files are drawn together.",
        show_default=False,
    ),
]
Builder = Annotated[
    str,
    typer.Option(
        help="sah, or a variant of the report's ladder: sequential, naive, range, cached, median, bin, atomic, "
        "flatten, flat, frontier; for render also brute: no tree.",
        rich_help_panel=TREE_PANEL,
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        help="Threads that build the tree, at most.",
        show_default="one per usable processor",
        rich_help_panel=TREE_PANEL,
    ),
]
Bins = Annotated[
    int | None,
    typer.Option(
        help="Bins per axis, 2 to 64.", show_default="16 for sah, 8 for the ladder", rich_help_panel=TREE_PANEL
    ),
]
LeafSize = Annotated[int, typer.Option(help="Most triangles in a leaf.", rich_help_panel=TREE_PANEL)]
TraversalCost = Annotated[
    float, typer.Option(help="Cost of a node step, in triangle tests.", rich_help_panel=TREE_PANEL)
]
TaskThreshold = Annotated[
    int | None,
    typer.Option(
        help="Most triangles in one task of a worker.",
        show_default="depends on mesh and workers",
        rich_help_panel=TREE_PANEL,
    ),
]
Frontier = Annotated[
    int, typer.Option(help="Most triangles in a leaf, for the builder frontier.", rich_help_panel=TREE_PANEL)
]
Quality = Annotated[
    str,
    typer.Option(
        help="Quality of the tree, for the builder sah: fast (to build), default or high.", rich_help_panel=TREE_PANEL
    ),
]
UseCache = Annotated[
    bool,
    typer.Option(
        "--cache", help="Keep the tree for later runs, and use one that was kept.", rich_help_panel=TREE_PANEL
    ),
]
CacheFolder = Annotated[
    Path | None,
    typer.Option(
        "--cache-dir",
        metavar="DIR",
        help="Like --cache, in this folder.",
        show_default="CLBVH_CACHE, or the user's cache",
        rich_help_panel=TREE_PANEL,
    ),
]
Device = Annotated[
    str | None,
    typer.Option(
        help="A number, a part of a name, gpu or cpu; see `clbvh devices`.",
        show_default="a GPU, if there is one",
        rich_help_panel=DEVICE_PANEL,
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of the tables.")]


def open_sources(sources: list[str]) -> Scene:
    """Return the scene of the command line: one scene or mesh, or several mesh files together."""
    from ..rendering.open_scene import open_mesh_files, open_scene

    return open_scene(sources[0]) if len(sources) == 1 else open_mesh_files(sources)


def print_notes(notes: Iterable[str]) -> None:
    """Print what the user should know on stderr, each as one line."""
    for note in notes:
        print(f"clbvh: {note}", file=sys.stderr)


def make_build_options(
    bins: int | None, leaf_size: int, traversal_cost: float, task_threshold: int | None, frontier: int, quality: str
) -> BuildOptions:
    """Return the options of a build, checked."""
    from ..builders.options import BuildOptions

    return BuildOptions(bins, leaf_size, traversal_cost, task_threshold, frontier, quality)


def find_cache_folder(use_cache: bool, folder: Path | None) -> Path | None:
    """Return the folder for kept trees by `--cache` and `--cache-dir`, None without either.

    None, said once, also where the user's cache cannot be written to; a folder that is named must be one.
    """
    from ..builders.tree_cache import find_tree_cache
    from ..support.folders import is_writable, say_unusable

    if folder is not None or not use_cache:
        return folder
    users = find_tree_cache()
    if is_writable(users):
        return users
    say_unusable(users.parent)
    return None
