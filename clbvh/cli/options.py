"""Options that several verbs share: written once, or derived from the fields of a dataclass.

Must not import numpy, nor what does: the help of a verb imports this.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypedDict, TypeVar

from cyclopts import Group, Parameter, Token

from ..builders.options import BuildOptions
from ..builders.tree_options import TreeOptions
from ..rendering.options import RenderOptions
from ..rendering.settings import list_settings
from ..rendering.view import View

_Verb = TypeVar("_Verb", bound=Callable[..., None])
_Options = TypeVar("_Options", bound=TreeOptions)

_FIRST_PANEL = 10
_LONGEST_METAVAR = 24  # characters; cyclopts breaks longer ones
_TREE_PANEL = Group("Tree and device", sort_key=99)

_SOURCE_HELP = (
    "A mesh file (PLY, OBJ, STL, OFF, GLB, glTF), a scene file (.toml), or a shipped scene: "
    "demo, bunny, cornell, dragon, drill, galaxy, hall, knot, meadow, palace, still-life, terrain, weekend."
)
DEVICE_HELP = "A number, a part of a name, gpu or cpu; see `clbvh devices`."

Source = Annotated[str, Parameter(name="MESH|SCENE", help=_SOURCE_HELP)]
Sources = Annotated[
    str, Parameter(name="MESH|SCENE", help=f"{_SOURCE_HELP} Several mesh files are drawn together.", required=True)
]
Outputs = Annotated[
    list[Path],
    Parameter(
        name=("--output", "-o"),
        metavar="FILE",
        help="File of the picture, .png, .jpg or .ppm; may be given several times.",
    ),
]
Device = Annotated[str | None, Parameter(metavar="DEVICE", help=DEVICE_HELP, show_default="a GPU, if there is one")]
AsJson = Annotated[bool, Parameter(name="--json", help="Print one JSON object instead of tables.")]

Given = Mapping[str, Any]
"""The options that were given, by the names of their fields."""

NOTHING: Given = MappingProxyType({})

_UseCache = Annotated[
    bool, Parameter(help="Keep the tree for later runs, and use one that was kept.", group=_TREE_PANEL)
]
_CacheFolder = Annotated[
    Path,
    Parameter(
        metavar="DIR",
        help="Like --cache, in this folder.",
        show_default="CLBVH_CACHE, or the user's cache",
        group=_TREE_PANEL,
    ),
]


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


def list_view_options(*, without: tuple[str, ...] = (), shown: Mapping[str, str] = NOTHING) -> dict[str, Any]:
    """Return the options of the settings of a view, without some, and some with another default in the help."""
    options: dict[str, Any] = {}
    panels: dict[str, Group] = {}
    for setting in list_settings(View):
        if not setting.is_option or setting.name in without:
            continue
        kind, help_text, metavar = setting.kind, setting.help, setting.kind.metavar
        if len(metavar) > _LONGEST_METAVAR:
            help_text, metavar = f"{help_text.removesuffix('.')}: {kind.text}.", ""
        group = panels.setdefault(setting.panel, Group(setting.panel, sort_key=_FIRST_PANEL + len(panels)))
        options[setting.name] = Annotated[
            kind.option,
            Parameter(
                help=help_text,
                metavar=metavar or None,
                # A scene file may have switched it on.
                negative=f"--no-{setting.name}" if kind.option is bool else (),
                allow_leading_hyphen=True,
                converter=read_whole if kind.option is int else None,
                show_default=shown.get(setting.name) or setting.shown or _describe_default(setting.default),
                group=group,
            ),
        ]
    return options


def _describe_default(value: Any) -> str | None:
    """Return the default of an option for the help; None where there is nothing to say."""
    if value is None or isinstance(value, bool | tuple):
        return None
    return f"{value:g}" if isinstance(value, float) else str(value)


def read_changes(given: Given) -> dict[str, Any]:
    """Return the changes of a view that options make: an environment asks for the shading that sees it."""
    return {"shading": "path", **given} if "environment" in given else {**given}


def list_tree_options(kind: type = RenderOptions, *, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the options of a dataclass of tree options, with the texts of its docstring."""
    options: dict[str, Any] = {}
    texts = _read_attributes(kind)
    for field in fields(kind):
        if field.name == "build":
            options |= list_tree_options(BuildOptions)
        elif field.name == "cache":
            options |= {"cache": _UseCache, "cache_dir": _CacheFolder}
        else:
            # The first of these types that the annotation names.
            words = re.findall(r"\w+", str(field.type))
            value_type = next(found for found in (str, bool, int, float) if found.__name__ in words)
            default = _describe_default(field.default)
            options[field.name] = Annotated[
                value_type,
                Parameter(
                    help=texts.get(field.name),
                    converter=read_whole if value_type is int else None,
                    show_default=default,
                    group=_TREE_PANEL,
                ),
            ]
    return {name: option for name, option in options.items() if name not in without}


def _read_attributes(kind: type) -> dict[str, str]:
    """Return the texts about the attributes in the docstrings of a dataclass and of those that it extends."""
    texts: dict[str, str] = {}
    for owner in reversed(kind.__mro__):
        for name, text in re.findall(
            r"^(\w+) : .*((?:\n    .+)+)", inspect.cleandoc(owner.__doc__ or ""), re.MULTILINE
        ):
            texts[name] = " ".join(re.sub('`|"', "", text).split())
    return texts


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
    from ..builders.tree_cache import find_tree_cache
    from ..support.folders import is_writable, say_unusable

    if folder is not None or not use_cache:
        return folder
    users = find_tree_cache()
    if is_writable(users):
        return users
    say_unusable(users.parent)
    return None
