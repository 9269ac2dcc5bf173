"""Options of pictures: what they show, from where, and how. Each is a setting of `Scene`, and the verbs share them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

from .options import make_option

if TYPE_CHECKING:
    from ..rendering.cut import Cut
    from ..rendering.scene import Scene
    from ..rendering.settings import Vector, Wireframe

scene_option, samples_option = make_option("Scene"), make_option("Samples and colours")

_AXES = ("x", "y", "z")

# Settings of `Scene` that are taken as they are given.
_AS_GIVEN = (
    "width", "height", "fov", "frame", "shading", "samples", "seed", "smooth", "ground", "transparent", "exposure",
    "tone_curve", "max_bounces", "clamp", "environment", "environment_rotation", "environment_strength", "aperture",
)  # fmt: skip

Width = Annotated[int | None, scene_option("Pixels.", "800")]
Height = Annotated[int | None, scene_option("Pixels.", "450")]
Eye = Annotated[str | None, scene_option("Position of the camera.", "sees the whole mesh", metavar="X,Y,Z")]
LookAt = Annotated[str | None, scene_option("Point that the camera looks at.", metavar="X,Y,Z")]
Up = Annotated[
    str | None,
    scene_option(
        "Direction that is up in the picture; auto: y or z, by the shape.",
        "auto for mesh files, y for glTF and scenes",
        metavar="X,Y,Z|y|z|auto",
    ),
]
Fov = Annotated[float | None, scene_option("Vertical field of view in degrees.", "35")]
View = Annotated[
    str | None,
    scene_option(
        "front, right, back, left, top, bottom or iso: the whole mesh from this side.",
        "a little from the right and above",
    ),
]
Frame = Annotated[
    str | None,
    scene_option(
        "What the picture of the whole shows: auto leaves out a few small parts far away from the rest.",
        "auto",
        metavar="auto|all",
    ),
]
CameraKind = Annotated[
    str | None,
    scene_option(
        "perspective, orthographic, fisheye or panorama; with the height of an orthographic picture or the "
        "degrees of a fisheye as in fisheye:220.",
        "perspective",
        metavar="KIND",
    ),
]
CutPlane = Annotated[
    str | None,
    scene_option(
        "Do not show what lies on the normal's side of a plane through a point; light comes as if it were there.",
        metavar='"X,Y,Z;NX,NY,NZ"',
        flag="--cut",
    ),
]
CutBox = Annotated[
    str | None,
    scene_option(
        "Do not show what lies inside a box, by its lower and its upper corner.",
        metavar='"X,Y,Z;X,Y,Z"',
        flag="--cut-box",
    ),
]
Background = Annotated[str | None, scene_option("Linear colour, each 0 to 1.", metavar="R,G,B")]


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


def read_settings(given: Mapping[str, Any], *, without: Sequence[str] = ()) -> dict[str, Any]:
    """Return the settings of a scene among the parameters of a command; None for an option that was not given.

    Raises
    ------
    ConfigError, SceneError
        A text cannot be read.
    """
    parsed = {
        "eye": parse_vector("--eye", given.get("eye")),
        "look_at": parse_vector("--look-at", given.get("look_at")),
        "up": parse_up(given.get("up")),
        "cut": parse_cut(given.get("cut"), given.get("cut_box")),
        # One colour stands for top and bottom.
        "background": parse_vector("--background", given.get("background")),
        "focus_distance": given.get("focus"),
        "wireframe": _parse_wireframe(given),
    }
    return {name: given.get(name) for name in _AS_GIVEN if name not in without} | parsed


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
    from ..rendering.cameras.projection import read_projection

    if camera is not None:
        projection = read_projection(camera)
        if projection is not None and changes.get("fov") is not None:
            raise ConfigError(f"--fov is that of a perspective camera, and --camera is '{camera}'")
        scene = replace(scene, projection=projection)
    return (scene if view is None else scene.with_view(view)).with_changes(**changes)


Shading = Annotated[
    str | None,
    scene_option(
        "studio, ao or path; lambert, lambert+shadow, normal or depth, with one ray for each pixel.", "studio"
    ),
]
Samples = Annotated[int | None, samples_option("Rays through each pixel, for studio, ao and path.", "16, 16 and 64")]
TimeLimit = Annotated[
    float | None,
    samples_option(
        "Take as many samples as this time allows; one at least.", "no limit", metavar="SECONDS", flag="--time"
    ),
]
Keep = Annotated[bool, samples_option("On Ctrl-C, write the picture of the samples so far.", flag="--keep")]
Seed = Annotated[int | None, samples_option("Of the sample points.", "0")]
Smooth = Annotated[
    float | None,
    samples_option(
        "Look smooth over edges that turn by less; 0: facets. Given, also in place of a file's normals.",
        "40, for meshes without normals",
        metavar="DEGREES",
    ),
]
Ground = Annotated[
    bool | None,
    samples_option("Put a ground below all objects (studio, path).", "in studio alone", flag="--ground/--no-ground"),
]
Transparent = Annotated[
    bool | None, samples_option("Leave the background out, in a PNG with alpha.", flag="--transparent")
]
ShowWireframe = Annotated[bool, samples_option("Draw the edges of triangles.", flag="--wireframe")]
WireframeWidth = Annotated[float | None, samples_option("Of their lines.", "1", metavar="PIXELS")]
WireframeColour = Annotated[
    str | None, samples_option("Of their lines, linear, each 0 to 1.", "0,0,0", metavar="R,G,B")
]
Exposure = Annotated[float | None, samples_option("Brighten studio, ao and path.", "0", metavar="STOPS")]
ToneCurve = Annotated[
    str | None, samples_option("linear, or filmic: bright light does not become white at once.", "filmic for path")
]
Environment = Annotated[
    str | None,
    samples_option(
        "Light from a panorama, .hdr or .exr. Without --shading, the shading is path.", "the background", metavar="FILE"
    ),
]
EnvironmentRotation = Annotated[float | None, samples_option("Turn it about the up direction.", "0", metavar="DEGREES")]
EnvironmentStrength = Annotated[float | None, samples_option("Of its light.", "1", metavar="FACTOR")]
MaxBounces = Annotated[int | None, samples_option("Reflections after which a path ends.", "12")]
Clamp = Annotated[
    float | None,
    samples_option(
        "Limit the light of a sample (path): no bright dots, and a picture that is a little too dark.",
        "no limit",
        metavar="LIGHT",
    ),
]


def _parse_wireframe(given: Mapping[str, Any]) -> Wireframe | None:
    """Return the lines of ``--wireframe``; its width and its colour ask for them, too."""
    from ..rendering.settings import Wireframe

    colour = parse_vector("--wireframe-colour", given.get("wireframe_colour"))
    values = {"width": given.get("wireframe_width"), "colour": colour}
    wanted: dict[str, Any] = {name: value for name, value in values.items() if value is not None}
    return Wireframe(**wanted) if given.get("wireframe") or wanted else None
