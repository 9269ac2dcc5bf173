"""Options that several verbs share: written once, or derived from the fields of a dataclass.

Must not import numpy, nor what does: the help of a verb imports this.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypedDict, TypeVar

from cyclopts import Group, Parameter, Token

from ..builders.options import BuildOptions
from ..builders.tree_options import TreeOptions
from ..rendering.options import RenderOptions
from ..support.settings import list_settings, settings_of
from ..views.view import View

_Verb = TypeVar("_Verb", bound=Callable[..., None])
_Options = TypeVar("_Options", bound=TreeOptions)

_FIRST_PANEL = 10
_LONGEST_METAVAR = 24  # characters; cyclopts breaks longer ones
_TREE_PANEL = Group("Tree and device", sort_key=99)

_SOURCE_HELP = (
    "A mesh file (PLY, OBJ, STL, OFF, GLB, glTF, 3MF, DAE, STEP), a scene file (.toml), or a shipped scene: "
    "demo, bunny, cornell, dragon, drill, galaxy, hall, knot, meadow, palace, still-life, terrain, weekend."
)
_CACHE_HELP = "Keep the tree for later runs, and use one that was kept."
_FOLDER_HELP, _FOLDER_DEFAULT = "Like --cache, in this folder.", "CLBVH_CACHE, or the user's cache"
DEVICE_HELP = "A number, a part of a name, gpu or host; see `clbvh devices`."

Source = Annotated[str, Parameter(name="MESH|SCENE", help=_SOURCE_HELP)]
Sources = Annotated[
    str, Parameter(name="MESH|SCENE", help=f"{_SOURCE_HELP} Several mesh files are drawn together.", required=True)
]
OUTPUT = Parameter(name=("--output", "-o"), metavar="FILE")
Outputs = Annotated[
    list[Path], OUTPUT, Parameter(help="File of the picture, .png, .jpg or .ppm; may be given several times.")
]
PointRadius = Annotated[
    float | None,
    Parameter(help="Radius of the spheres around the points of a file without faces.", show_default="by their spacing"),
]
Device = Annotated[str | None, Parameter(metavar="DEVICE", help=DEVICE_HELP, show_default="a GPU, if there is one")]
AsJson = Annotated[bool, Parameter(name="--json", help="Print one JSON object instead of tables.")]

# Settings of a view of which a verb with its own cameras leaves out some.
POSE = "eye", "look_at", "side"
LENS = "fov", "projection", "aperture", "focus_distance"

Given = Mapping[str, Any]
"""The options that were given, by the names of their fields."""

NOTHING: Given = MappingProxyType({})


def read_whole(kind: type, tokens: Sequence[Token]) -> int:
    """Return the whole number of an option; cyclopts would round 3.5."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"'{tokens[0].value}' is not a whole number") from None


def with_options(**parameters: dict[str, Any]) -> Callable[[_Verb], _Verb]:
    """Give parameters of a verb, which are mappings, their options: annotated types, by the names of fields."""

    def annotate(verb: _Verb) -> _Verb:
        for name, options in parameters.items():
            given = TypedDict(name, options, total=False)  # type: ignore[misc] # made from a list
            verb.__annotations__[name] = Annotated[given, Parameter(name="*")]
        return verb

    return annotate


def _make_option(kind: type, text: str | None, default: Any, group: Group, **more: Any) -> Any:
    """Return the type of an option with its text, and its default where the help has something to say."""
    is_said = default is not None and not isinstance(default, bool | tuple)
    return Annotated[
        kind,
        Parameter(
            help=text,
            converter=read_whole if kind is int else None,
            show_default=(f"{default:g}" if isinstance(default, float) else str(default)) if is_said else None,
            group=group,
            **more,
        ),
    ]


def list_view_options(*, without: tuple[str, ...] = (), shown: Mapping[str, str] = NOTHING) -> dict[str, Any]:
    """Return the options of the settings of a view, without some, and some with another default in the help."""
    panels: dict[str, Group] = {}
    options = {}
    for setting in list_settings(View):
        if not setting.is_option or setting.name in without:
            continue
        kind, text, metavar = setting.kind, setting.help, setting.kind.metavar
        if len(metavar) > _LONGEST_METAVAR:
            text, metavar = f"{text.removesuffix('.')}: {kind.text}.", ""
        options[setting.name] = _make_option(
            kind.option, text, shown.get(setting.name) or setting.shown or setting.default,
            panels.setdefault(setting.panel, Group(setting.panel, sort_key=_FIRST_PANEL + len(panels))),
            # A scene file may have switched a flag on.
            metavar=metavar or None, negative=f"--no-{setting.name}" if kind.option is bool else (),
            allow_leading_hyphen=True,
        )  # fmt: skip
    return options


def find_source(sources: Sequence[str], point_radius: float | None) -> Any:
    """Return what is to be drawn: the paths, or a scene of points with a radius."""
    if point_radius is None:
        return list(sources)
    from ..files.open_scene import open_points

    return open_points(sources, point_radius)


def read_changes(given: Given) -> dict[str, Any]:
    """Return the changes of a view that options make: an environment asks for the shading that sees it."""
    return {"shading": "path", **given} if "environment" in given else {**given}


def list_tree_options(kind: type = RenderOptions, *, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the options of a dataclass of tree options."""
    options: dict[str, Any] = {}
    for field in fields(kind):
        if field.name == "build":
            options |= list_tree_options(BuildOptions)
        elif field.name == "cache":
            options["cache"] = _make_option(bool, _CACHE_HELP, None, _TREE_PANEL)
            options["cache_dir"] = _make_option(Path, _FOLDER_HELP, _FOLDER_DEFAULT, _TREE_PANEL, metavar="DIR")
        else:
            setting = settings_of(kind)[field.name]
            default, metavar = setting.shown or setting.default, setting.kind.metavar or None
            options[field.name] = _make_option(setting.kind.option, setting.help, default, _TREE_PANEL, metavar=metavar)
    return {name: option for name, option in options.items() if name not in without}


def make_options(kind: type[_Options], given: Given) -> _Options:
    """Return the options of a tree, or of a rendering, from those of the command line."""
    names = {field.name for field in fields(BuildOptions)}
    build = BuildOptions(**{name: value for name, value in given.items() if name in names})
    others = {name: value for name, value in given.items() if name not in names | {"cache", "cache_dir"}}
    return kind(build=build, cache=find_cache_folder(given.get("cache", False), given.get("cache_dir")), **others)


def find_cache_folder(use_cache: bool, folder: Path | None) -> Path | None:
    """Return the folder for kept trees by `--cache` and `--cache-dir`, None without either.

    None, said once, also where the user's cache cannot be written to; a folder that is named must be one.
    """
    if folder is not None or not use_cache:
        return folder
    from ..builders.tree_cache import find_tree_cache  # a command that opens a page first does not wait for it
    from ..support.folders import is_writable, say_unusable

    users = find_tree_cache()
    if is_writable(users):
        return users
    say_unusable(users.parent)
    return None
