"""Options of what a picture shows and from where: the camera, the cut, the size. The verbs of pictures share them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ..rendering.cut import Cut
    from ..rendering.scene import Scene
    from ..rendering.vectors import Vector

SCENE_PANEL = "Scene"

_AXES = ("x", "y", "z")

Width = Annotated[int | None, typer.Option(help="Pixels.", show_default="800", rich_help_panel=SCENE_PANEL)]
Height = Annotated[int | None, typer.Option(help="Pixels.", show_default="450", rich_help_panel=SCENE_PANEL)]
Eye = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z",
        help="Position of the camera.",
        show_default="sees the whole mesh",
        rich_help_panel=SCENE_PANEL,
    ),
]
LookAt = Annotated[
    str | None,
    typer.Option(metavar="X,Y,Z", help="Point that the camera looks at.", rich_help_panel=SCENE_PANEL),
]
Up = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z|y|z|auto",
        help="Direction that is up in the picture; auto: y or z, by the shape.",
        show_default="auto for mesh files, y for glTF and scenes",
        rich_help_panel=SCENE_PANEL,
    ),
]
Fov = Annotated[
    float | None,
    typer.Option(help="Vertical field of view in degrees.", show_default="35", rich_help_panel=SCENE_PANEL),
]
View = Annotated[
    str | None,
    typer.Option(
        help="front, right, back, left, top, bottom or iso: the whole mesh from this side.",
        show_default="a little from the right and above",
        rich_help_panel=SCENE_PANEL,
    ),
]
Frame = Annotated[
    str | None,
    typer.Option(
        metavar="auto|all",
        help="What the picture of the whole shows: auto leaves out a few small parts far away from the rest.",
        show_default="auto",
        rich_help_panel=SCENE_PANEL,
    ),
]
CameraKind = Annotated[
    str | None,
    typer.Option(
        metavar="KIND",
        help="perspective, orthographic, fisheye or panorama; with the height of an orthographic picture or the "
        "degrees of a fisheye as in fisheye:220.",
        show_default="perspective",
        rich_help_panel=SCENE_PANEL,
    ),
]
CutPlane = Annotated[
    str | None,
    typer.Option(
        "--cut",
        metavar='"X,Y,Z;NX,NY,NZ"',
        help="Do not show what lies on the normal's side of a plane through a point; light comes as if it were there.",
        rich_help_panel=SCENE_PANEL,
    ),
]
CutBox = Annotated[
    str | None,
    typer.Option(
        "--cut-box",
        metavar='"X,Y,Z;X,Y,Z"',
        help="Do not show what lies inside a box, by its lower and its upper corner.",
        rich_help_panel=SCENE_PANEL,
    ),
]
Background = Annotated[
    str | None, typer.Option(metavar="R,G,B", help="Linear colour, each 0 to 1.", rich_help_panel=SCENE_PANEL)
]


def parse_vector(option: str, text: str | None) -> Vector | None:
    """Return the three numbers of an option such as ``--eye 1,2,3``."""
    from ..errors import ConfigError

    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(
            f"{option} needs three numbers with commas between them, such as 1,2,3, not '{text}'"
        ) from error
    return x, y, z


def parse_up(text: str | None) -> Vector | str | None:
    """Return the direction of ``--up``, which may be an axis such as ``z``, ``+z`` or ``-z``, or ``"auto"``."""
    from ..errors import ConfigError

    if text is None or text == "auto":
        return text
    if text.lower().lstrip("+-") in _AXES and len(text) <= len("-z"):
        length = -1.0 if text.startswith("-") else 1.0
        x, y, z = (length if text[-1].lower() == axis else 0.0 for axis in _AXES)
        return x, y, z
    try:
        return parse_vector("--up", text)
    except ConfigError as error:
        raise ConfigError(f"--up needs x, y or z, three numbers such as 0,0,1, or auto, not '{text}'") from error


def parse_cut(plane: str | None, box: str | None) -> Cut | None:
    """Return the cut of ``--cut`` or ``--cut-box``."""
    from ..errors import ConfigError
    from ..rendering.cut import parse_cut as parse

    if plane is not None and box is not None:
        raise ConfigError("--cut and --cut-box were given: a picture has one cut")
    if plane is not None:
        return parse("plane", plane)
    return None if box is None else parse("box", box)


def parse_view(
    *,
    eye: str | None = None,
    look_at: str | None = None,
    up: str | None = None,
    cut: str | None = None,
    cut_box: str | None = None,
    background: str | None = None,
    **settings: Any,
) -> dict[str, Any]:
    """Return settings of a scene by their names; None where an option was not given.

    Raises
    ------
    ConfigError, SceneError
        A text cannot be read.
    """
    return {
        "eye": parse_vector("--eye", eye),
        "look_at": parse_vector("--look-at", look_at),
        "up": parse_up(up),
        "cut": parse_cut(cut, cut_box),
        # One colour stands for top and bottom.
        "background": parse_vector("--background", background),
        **settings,
    }


def with_view(scene: Scene, changes: dict[str, Any], camera: str | None = None, view: str | None = None) -> Scene:
    """Return the scene with changed settings, a camera of another kind, which may be perspective, or a side to see.

    Parameters
    ----------
    scene : Scene
    changes : dict of str to setting
        Those that are None are left out.
    camera : str, optional
        The text of ``--camera``.
    view : str, optional
        The text of ``--view``.
    """
    from ..errors import ConfigError
    from ..rendering.projection import parse_projection

    if camera is not None:
        projection = parse_projection(camera)
        if projection is not None and changes.get("fov") is not None:
            raise ConfigError(f"--fov is that of a perspective camera, and --camera is '{camera}'")
        scene = replace(scene, projection=projection)
    return (scene if view is None else scene.with_view(view)).with_changes(**changes)
