"""Options of the pictures that `clbvh render` draws: each is a setting of `Scene` with the same name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from .view_options import SCENE_PANEL, parse_vector

if TYPE_CHECKING:
    from ..rendering.settings import Wireframe

SAMPLES_PANEL = "Samples and colours"

Shading = Annotated[
    str | None,
    typer.Option(
        help="studio, ao or path; lambert, lambert+shadow, normal or depth, with one ray for each pixel.",
        show_default="studio",
        rich_help_panel=SCENE_PANEL,
    ),
]
Samples = Annotated[
    int | None,
    typer.Option(
        help="Rays through each pixel, for studio, ao and path.",
        show_default="16, 16 and 64",
        rich_help_panel=SAMPLES_PANEL,
    ),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(
        "--time",
        metavar="SECONDS",
        help="Take as many samples as this time allows; one at least.",
        show_default="no limit",
        rich_help_panel=SAMPLES_PANEL,
    ),
]
Keep = Annotated[
    bool,
    typer.Option("--keep", help="On Ctrl-C, write the picture of the samples so far.", rich_help_panel=SAMPLES_PANEL),
]
Seed = Annotated[
    int | None, typer.Option(help="Of the sample points.", show_default="0", rich_help_panel=SAMPLES_PANEL)
]
Smooth = Annotated[
    float | None,
    typer.Option(
        metavar="DEGREES",
        help="Look smooth over edges that turn by less; 0: facets. Given, also in place of a file's normals.",
        show_default="40, for meshes without normals",
        rich_help_panel=SAMPLES_PANEL,
    ),
]
Ground = Annotated[
    bool | None,
    typer.Option(
        "--ground/--no-ground",
        help="Put a ground below all objects (studio, path).",
        show_default="in studio alone",
        rich_help_panel=SAMPLES_PANEL,
    ),
]
Transparent = Annotated[
    bool | None,
    typer.Option("--transparent", help="Leave the background out, in a PNG with alpha.", rich_help_panel=SAMPLES_PANEL),
]
ShowWireframe = Annotated[
    bool, typer.Option("--wireframe", help="Draw the edges of triangles.", rich_help_panel=SAMPLES_PANEL)
]
WireframeWidth = Annotated[
    float | None,
    typer.Option(metavar="PIXELS", help="Of their lines.", show_default="1", rich_help_panel=SAMPLES_PANEL),
]
WireframeColour = Annotated[
    str | None,
    typer.Option(
        metavar="R,G,B",
        help="Of their lines, linear, each 0 to 1.",
        show_default="0,0,0",
        rich_help_panel=SAMPLES_PANEL,
    ),
]
Exposure = Annotated[
    float | None,
    typer.Option(
        metavar="STOPS", help="Brighten studio, ao and path.", show_default="0", rich_help_panel=SAMPLES_PANEL
    ),
]
ToneCurve = Annotated[
    str | None,
    typer.Option(
        help="linear, or filmic: bright light does not become white at once.",
        show_default="filmic for path",
        rich_help_panel=SAMPLES_PANEL,
    ),
]
Environment = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Light from a panorama, .hdr or .exr. Without --shading, the shading is path.",
        show_default="the background",
        rich_help_panel=SAMPLES_PANEL,
    ),
]
EnvironmentRotation = Annotated[
    float | None,
    typer.Option(
        metavar="DEGREES",
        help="Turn it about the up direction.",
        show_default="0",
        rich_help_panel=SAMPLES_PANEL,
    ),
]
EnvironmentStrength = Annotated[
    float | None,
    typer.Option(metavar="FACTOR", help="Of its light.", show_default="1", rich_help_panel=SAMPLES_PANEL),
]
MaxBounces = Annotated[
    int | None,
    typer.Option(help="Reflections after which a path ends.", show_default="12", rich_help_panel=SAMPLES_PANEL),
]
Clamp = Annotated[
    float | None,
    typer.Option(
        metavar="LIGHT",
        help="Limit the light of a sample (path): no bright dots, and a picture that is a little too dark.",
        show_default="no limit",
        rich_help_panel=SAMPLES_PANEL,
    ),
]


def parse_wireframe(is_shown: bool, width: float | None, colour: str | None) -> Wireframe | None:
    """Return the lines of ``--wireframe``; its width and its colour ask for them, too."""
    from ..rendering.settings import Wireframe

    values: dict[str, Any] = {"width": width, "colour": parse_vector("--wireframe-colour", colour)}
    given = {name: value for name, value in values.items() if value is not None}
    return Wireframe(**given) if is_shown or given else None
