"""Options that several verbs share: each is defined once, and means the same everywhere."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ..rendering.scene import Scene


def make_option(panel: str) -> Callable[..., Any]:
    """Return a short form of `typer.Option` for the options of one panel of the help."""

    def make(text: str, shown: str | bool = True, *, metavar: str | None = None, flag: str | None = None) -> Any:
        flags = [] if flag is None else [flag]
        return typer.Option(*flags, help=text, show_default=shown, metavar=metavar, rich_help_panel=panel)

    return make


tree_option, device_option = make_option("Tree"), make_option("Device")

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
    tree_option(
        "sah, or a variant of the report's ladder: sequential, naive, range, cached, median, bin, atomic, "
        "flatten, flat, frontier; for render also brute: no tree."
    ),
]
Workers = Annotated[int | None, tree_option("Threads that build the tree, at most.", "one per usable processor")]
Bins = Annotated[int | None, tree_option("Bins per axis, 2 to 64.", "16 for sah, 8 for the ladder")]
LeafSize = Annotated[int, tree_option("Most triangles in a leaf.")]
TraversalCost = Annotated[float, tree_option("Cost of a node step, in triangle tests.")]
TaskThreshold = Annotated[
    int | None, tree_option("Most triangles in one task of a worker.", "depends on mesh and workers")
]
Frontier = Annotated[int, tree_option("Most triangles in a leaf, for the builder frontier.")]
Quality = Annotated[str, tree_option("Quality of the tree, for the builder sah: fast (to build), default or high.")]
UseCache = Annotated[bool, tree_option("Keep the tree for later runs, and use one that was kept.", flag="--cache")]
CacheFolder = Annotated[
    Path | None,
    tree_option("Like --cache, in this folder.", "CLBVH_CACHE, or the user's cache", metavar="DIR", flag="--cache-dir"),
]
_DEVICE_TEXTS = "A number, a part of a name, gpu or cpu; see `clbvh devices`.", "a GPU, if there is one"
Device = Annotated[str | None, device_option(*_DEVICE_TEXTS)]
# For verbs that have no other options of the device.
OnlyDevice = Annotated[str | None, typer.Option(help=_DEVICE_TEXTS[0], show_default=_DEVICE_TEXTS[1])]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of the tables.")]


def open_sources(sources: list[str]) -> Scene:
    """Return the scene of the command line: one scene or mesh, or several mesh files together."""
    from ..rendering.open_scene import open_mesh_files, open_scene

    return open_scene(sources[0]) if len(sources) == 1 else open_mesh_files(sources)


def print_notes(notes: Iterable[str]) -> None:
    """Print what the user should know on stderr, each as one line."""
    for note in notes:
        print(f"clbvh: {note}", file=sys.stderr)


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
