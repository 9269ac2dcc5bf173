"""Every setting of a picture, once: its type, its limits, its default, and one line of help.

Imports no numpy, see `settings.py`. What a setting does is written where it is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..choices import REPORT_SHADINGS, SHADINGS, STANDARD_VIEWS, TONE_CURVES
from ..errors import SceneError
from ..support.settings import (
    Kind,
    Vector,
    change_settings,
    check_settings,
    flag,
    group,
    number,
    one_of,
    setting,
    vector,
    whole,
)
from .cameras.projection import DEFAULT_FOV, PROJECTION, UP, Fisheye, Orthographic, Panorama, check_focus
from .cut import Cut, as_cut

if TYPE_CHECKING:
    from .cameras.camera import Camera
    from .environment_map import EnvironmentMap

CAMERA, LIGHT, SHADING, FILM = "Camera", "Light", "Shading", "Picture"

DEFAULT_WIDTH, DEFAULT_HEIGHT = 800, 450
MAX_SIDE = 65_535

# Enough for edges without steps and for soft shadows with little noise: 0.6 s for 800 x 450 on a 2-core x86-64 server.
_DEFAULT_SAMPLES = {"studio": 16, "ao": 16, "path": 64, "albedo": 16}

# Where the noise decides, and stays above what was asked for.
_MOST_NOISY_SAMPLES = 4096

# More would leave the numbers of the sample points.
MAX_SAMPLES = 2**24

# Light of 2^100 times the usual strength is still a float32; so are the brightest pixels of an environment times 1e10,
# and samples that are compared with 1e30.
_MAX_EXPOSURE, _MAX_STRENGTH, _MAX_CLAMP = 100.0, 1e10, 1e30

# Settings that choose a camera: a change of one of a row leaves out those of the other rows.
_CAMERA_CHOICES = ({"camera"}, {"side"}, {"eye", "look_at"})


@dataclass(frozen=True)
class Light:
    """A directed light, and ambient light from the sky and the ground. Colours are linear.

    Attributes
    ----------
    direction : (3,) float, or None
        Towards the light, in the scene's coordinates. None: from behind the viewer's left shoulder.
    colour : (3,) float
        Of the directed light, on a surface that faces it.
    sky, ground : (3,) float
        On a surface that faces up, and one that faces down.

    Raises
    ------
    SceneError
        A value is not three finite numbers, or the direction is zero.

    Examples
    --------
    >>> import clbvh
    >>> light = clbvh.Light(direction=(0, 1, 0), sky=(0.3, 0.3, 0.35))
    >>> picture = clbvh.render(clbvh.make_shape("icosphere", triangles=320), light=light, width=64, height=48)
    """

    direction: Vector | None = setting(
        None, "Direction towards the light.", vector(), shown="above, to the viewer's left"
    )
    colour: Vector = setting((0.92, 0.88, 0.82), "Linear colour of the directed light.", vector(metavar="R,G,B"))
    sky: Vector = setting((0.19, 0.21, 0.24), "Light on surfaces that face up.", vector(metavar="R,G,B"))
    ground: Vector = setting((0.07, 0.065, 0.06), "Light on surfaces that face down.", vector(metavar="R,G,B"))

    def __post_init__(self) -> None:
        check_settings(self, "light_")
        if self.direction is not None and not any(self.direction):
            raise SceneError("light_direction must not be zero")


@dataclass(frozen=True)
class Wireframe:
    """Lines along the edges of triangles, drawn over what the camera shows; spheres have none.

    Attributes
    ----------
    width : float, pixels
        The same at any distance.
    colour : (3,) float
        Linear, from 0 to 1. Neither light nor exposure changes it.

    Raises
    ------
    SceneError
        A value is out of range.

    Notes
    -----
    An edge is drawn on the triangle that is seen, on either side of it, so an outline has half the width. Where a
    triangle is lower than 6 widths of the line (6 pixels of a thin one), the line grows fainter, and there is none at
    1.5 widths: a dense mesh shows its surface, and no black. The lines are smooth, and depend on the pixel alone.

    Examples
    --------
    >>> import clbvh
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> picture = clbvh.render(ball, wireframe=True, wireframe_width=2, width=64, height=48)
    >>> bool(picture.rgb.mean() < clbvh.render(ball, width=64, height=48).rgb.mean())
    True
    """

    width: float = setting(1.0, "Width of the lines, in pixels.", number(above=0, most=1000))
    colour: Vector = setting((0.0, 0.0, 0.0), "Linear colour of the lines.", vector(0, 1, metavar="R,G,B"))

    def __post_init__(self) -> None:
        check_settings(self, "wireframe_")


@dataclass(frozen=True)
class Section:
    """What fills closed objects where a cut opens them.

    Attributes
    ----------
    fill : bool
        False: the inside is seen.
    colour : (3,) float
        Linear, from 0 to 1. Neither light nor exposure changes it.
    hatch : int, pixels
        From one oblique line to the next; 0: none.

    Raises
    ------
    SceneError
        A value is out of range.

    Notes
    -----
    An object is closed where its mesh encloses a volume, or it is a sphere: see `Mesh.is_watertight`. Where one object
    lies within another one, the section is that of the outer one up to the inner one.

    Examples
    --------
    >>> import clbvh
    >>> ball = clbvh.make_shape("icosphere", triangles=5120)
    >>> picture = clbvh.render(
    ...     ball, cut="z>0", section_colour=(1, 0, 0), side="front", up="y", shading="lambert", width=65, height=65
    ... )
    >>> picture.rgb[32, 32]
    array([255,   0,   0], dtype=uint8)
    """

    fill: bool = setting(True, "Fill closed objects where a cut opens them.", flag())
    colour: Vector = setting((0.55, 0.12, 0.06), "Linear colour of the section.", vector(0, 1, metavar="R,G,B"))
    hatch: int = setting(0, "Pixels from one line of its hatching to the next; 0: none.", whole(0, 1000))

    def __post_init__(self) -> None:
        check_settings(self, "section_")


def _colours() -> Kind:
    """Return one colour, or two: at the top and at the bottom."""
    colour = vector().read

    def read(value: Any) -> tuple[Vector, Vector]:
        parts = tuple(value.split(";") if isinstance(value, str) else value)
        pair = parts if len(parts) == 2 else (value, value)
        top, bottom = map(colour, pair)
        return top, bottom

    return Kind("three finite numbers, or two such colours: top and bottom", read, metavar="R,G,B[;R,G,B]")


def _read_camera(value: Any) -> Camera:
    from .cameras.camera import Camera

    if not isinstance(value, Camera):
        raise TypeError
    return value


def _read_environment(value: Any) -> EnvironmentMap | None:
    from .environment_map import as_environment

    return as_environment(value)


_CUT_TEXT = 'a clbvh.Cut, or a text such as "z=50%", "0,1,0;0,1,0" or "box 0,0,0;1,1,1"'


@dataclass(frozen=True)
class View:
    """All settings of a picture: what the camera sees of a scene, in which light, and how that becomes colours.

    Every setting has a default. The same names are keywords of `render`, keys of the `[view]` table of a scene file,
    and, with hyphens, options of `clbvh render`. Numbers may be numpy's; vectors may be arrays, or texts such as
    ``"1,2,3"``.

    Attributes
    ----------
    camera : Camera, or None
        None: chosen by the settings that follow; they count for nothing beside a camera, but for `up`.
    side : str, or None
        The whole scene from a side: ``"front"``, ``"right"``, ``"back"``, ``"left"``, ``"top"``, ``"bottom"`` or
        ``"iso"``. None: from the front, a little from the right and from above.
    eye, look_at : (3,) float, or None
        The position of the camera, and what it looks at. None: chosen so that the whole scene is visible.
    up : (3,) float, or str
        The direction that is up. ``"auto"``: y or z, guessed from the shape and the file format; `Picture.notes` says
        the guess. ``"x"``, ``"-y"``, ``"z"`` and so on are axes.
    frame : str
        What the whole is: ``"auto"``, all but a few small parts far away from everything else, or ``"all"``.
        `Picture.notes` says what was left out.
    fov : float
        Vertical field of view in degrees; of a perspective camera only.
    projection : Orthographic, Fisheye, Panorama or None
        None: perspective. Also as a text: ``"orthographic"``, ``"orthographic:2"``, ``"fisheye:220"``, ``"panorama"``.
        An orthographic camera without a height gets the one that shows everything.
    aperture, focus_distance : float, the scene's units
        Depth of field, see `Camera`.
    light : Light
    environment : EnvironmentMap, path, (h, w, 3) array, or None
        Light from all around, in ``path``: a panorama as an ``.hdr`` or ``.exr`` file, or as linear colours with the
        zenith's row first. Its middle column is along +x, and up is up. The directed light then shines only if it has
        a direction. None: the `background`, from below to above, or the sky of ``studio``, see `shading`.
    environment_rotation : float
        Degrees by which it is turned about the direction upwards, counter-clockwise seen from above.
    environment_strength : float
        Factor of its light.
    shading : str
        ``studio``, ``ao``, ``path`` and ``albedo`` take samples; ``lambert``, ``lambert+shadow``, ``normal`` and
        ``depth`` cast one ray through the centre of each pixel. ``albedo`` shows base colours alone. ``path`` begins
        with the light, the ground and the tone curve of ``studio`` unless a `light`, a `background`, an `environment`
        or a material that emits light is given, or the eye is among the objects.
    samples : int, or None
        Of each pixel, for the shadings with samples. None: 16, for ``path`` 64, and 4,096 at most with `noise`.
    noise : float
        Of ``path``: parts of the picture whose noise is below this get no more samples. It is the standard deviation,
        as a share of the light, to which 0.1 is added; 0.03 is hardly seen. 0: all pixels get the same samples.
    denoise : bool
        Whether the noise of ``studio``, ``ao`` and ``path`` is taken out, by Intel's Open Image Denoise: it keeps the
        edges and textures that base colours and normals show, and smooths what is seen in mirrors and glass. Needs
        pyoidn.
    seed : int
        Of the sample points. Equal seeds give equal pictures.
    max_bounces : int
        Reflections after which a path of ``path`` ends; 0: light that comes straight from a source.
    smooth : float
        Crease angle in degrees, of meshes without normals of their own; 0: flat shading. Meshes of more than 16.8
        million triangles are flat in any case.
    ground : bool, or None
        A ground below all objects: in ``studio`` it shows their shadows alone, in ``path`` it is a matte surface of
        middle grey, without an end but for a soft transition to the background. The other shadings have none. None: in
        ``studio``, and in ``path`` where nobody has chosen a light, see `shading`, and the picture is not transparent.
    surface : (3,) float
        Linear colour of objects without one of their own.
    cut : Cut, or None
        A part of the world that the camera does not see. Also as a text: ``"z=50%"`` cuts away what lies above the
        middle of the scene's height in z, ``"y<2"`` what lies below 2; ``"X,Y,Z;NX,NY,NZ"`` the normal's side of a
        plane through a point; ``"box X,Y,Z;X,Y,Z"`` the inside of a box.
    section : Section
        What fills closed objects where a cut opens them; `section_fill=False` shows their inside.
    wireframe : Wireframe, or None
        Lines along the edges of triangles; True for those of the default width and colour.
    width, height : int
        Pixels. By default 800 x 450, or the size of the camera's lens.
    exposure : float
        Stops by which the light of the shadings with samples is made brighter, or darker where negative.
    tone_curve : str, or None
        ``"linear"``, or ``"filmic"``, which keeps bright light from becoming white. None: filmic for ``path``
        where a light was chosen.
    clamp : float, or None
        Of ``path``: a sample with more light than that, in any channel, is made as much darker. That takes bright dots
        away, and with them light: the mean is no longer the right one. None: no limit.
    background : (3,) float, or a pair of them
        Linear colours at the top and at the bottom of the picture; one colour may be given for both.
    transparent : bool
        Whether the background is left out of the picture; see `Picture.alpha`.

    Raises
    ------
    SceneError
        A value is out of range, or two of them contradict each other.

    Examples
    --------
    >>> import clbvh
    >>> view = clbvh.View(shading="path", samples=8, width=64, height=48)
    >>> picture = clbvh.render(clbvh.make_shape("icosphere", triangles=320), view)
    >>> view.changed(samples=16, light_direction=(0, 1, 0)).light.direction
    (0.0, 1.0, 0.0)
    >>> view.changed(sample=4)
    Traceback (most recent call last):
    clbvh.errors.SceneError: there is no setting 'sample': did you mean 'samples'?
    """

    camera: Camera | None = setting(
        None, "The camera itself.", Kind("a clbvh.Camera", _read_camera), CAMERA, is_option=False
    )
    side: str | None = setting(
        None, "The whole scene from a side.", one_of(STANDARD_VIEWS), CAMERA, shown="a little from the right and above"
    )
    eye: Vector | None = setting(None, "Position of the camera.", vector(), CAMERA, shown="sees the whole scene")
    look_at: Vector | None = setting(None, "Point that the camera looks at.", vector(), CAMERA, shown="the middle")
    up: Vector | str = setting("auto", "Direction that is up.", UP, CAMERA, shown="auto: y or z, by the shape")
    frame: str = setting(
        "auto", "What the whole is; auto leaves out a few small parts far away from the rest.",
        one_of(("auto", "all")), CAMERA,
    )  # fmt: skip
    fov: float = setting(DEFAULT_FOV, "Vertical field of view in degrees.", number(above=0, below=180), CAMERA)
    projection: Orthographic | Fisheye | Panorama | None = setting(
        None,
        "perspective, orthographic, fisheye or panorama; with the height of an orthographic picture or the degrees of "
        "a fisheye as in fisheye:220.",
        PROJECTION, CAMERA, shown="perspective",
    )  # fmt: skip
    aperture: float = setting(0.0, "Diameter of the lens: depth of field.", number(0), CAMERA)
    focus_distance: float | None = setting(
        None, "Distance that is sharp with an aperture.", number(above=0), CAMERA, shown="that of the point looked at"
    )
    cut: Cut | None = setting(
        None,
        'A part that the camera does not see: above the middle ("z=50%"), below a height ("y<2"), on the normal\'s '
        'side of a plane ("X,Y,Z;NX,NY,NZ"), or in a box ("box X,Y,Z;X,Y,Z"). Light comes as if it were there.',
        Kind(_CUT_TEXT, as_cut, metavar="CUT"), CAMERA,
    )  # fmt: skip
    section: Section = setting(
        Section(), "What fills closed objects where a cut opens them.",
        group(Section, "a clbvh.Section, or a table of its settings"), CAMERA, is_option=False,
    )  # fmt: skip

    light: Light = setting(
        Light(), "The directed light and the sky.", group(Light, "a clbvh.Light, or a table of its settings"), LIGHT,
        is_option=False,
    )  # fmt: skip
    environment: EnvironmentMap | None = setting(
        None, "Light from a panorama, .hdr or .exr, in path.",
        Kind(
            "the path of an .hdr or .exr file, or an (h, w, 3) array", _read_environment, metavar="FILE",
            takes_arrays=True,
        ), LIGHT, shown="the background",
    )  # fmt: skip
    environment_rotation: float = setting(0.0, "Degrees by which it is turned about up.", number(), LIGHT)
    environment_strength: float = setting(1.0, "Factor of its light.", number(0, _MAX_STRENGTH), LIGHT)

    shading: str = setting(
        "studio",
        "studio, ao, path and albedo take samples; the others cast one ray for each pixel.",
        one_of(SHADINGS),
        SHADING,
    )
    samples: int | None = setting(
        None,
        "Rays through each pixel, for studio, ao, path and albedo.",
        whole(1, MAX_SAMPLES),
        SHADING,
        shown="16; 64 for path",
    )
    noise: float = setting(
        0.0, "Sample until the noise is below this share of the light (path): 0.03 is hardly seen.", number(0, 1),
        SHADING, shown="all pixels get the same samples",
    )  # fmt: skip
    denoise: bool = setting(False, "Take the noise of studio, ao and path out (needs pyoidn).", flag(), SHADING)
    seed: int = setting(0, "Of the sample points.", whole(0, 2**32 - 1), SHADING)
    max_bounces: int = setting(12, "Reflections after which a path ends.", whole(0, 1000), SHADING)
    smooth: float = setting(
        40.0, "Crease angle in degrees, for meshes without normals; 0: flat.", number(0, 180), SHADING
    )
    ground: bool | None = setting(
        None, "A ground below all objects, in studio and path.", flag(), SHADING, shown="unless path has a light"
    )
    surface: Vector = setting(
        (0.80, 0.72, 0.60), "Linear colour of objects without one.", vector(metavar="R,G,B"), SHADING
    )
    wireframe: Wireframe | None = setting(
        None, "Draw the edges of triangles.", group(Wireframe, "a clbvh.Wireframe, or True"), SHADING
    )

    width: int = setting(None, "Pixels.", whole(1, MAX_SIDE), FILM, shown=str(DEFAULT_WIDTH))
    height: int = setting(None, "Pixels.", whole(1, MAX_SIDE), FILM, shown=str(DEFAULT_HEIGHT))
    exposure: float = setting(
        0.0, "Stops by which studio, ao and path are brighter.", number(-_MAX_EXPOSURE, _MAX_EXPOSURE), FILM
    )
    tone_curve: str | None = setting(
        None, "filmic: bright light does not become white at once.", one_of(TONE_CURVES), FILM,
        shown="filmic for path with a light",
    )  # fmt: skip
    clamp: float | None = setting(
        None, "Limit the light of a sample (path): no bright dots, but a picture that is a little too dark.",
        number(above=0, most=_MAX_CLAMP), FILM, shown="no limit",
    )  # fmt: skip
    background: tuple[Vector, Vector] = setting(
        ((0.42, 0.50, 0.60), (0.86, 0.88, 0.90)), "Linear colours of the top and the bottom.", _colours(), FILM
    )
    transparent: bool = setting(False, "Leave the background out, in a PNG with alpha.", flag(), FILM)

    def __post_init__(self) -> None:
        check_settings(self)
        size = self.width, self.height
        if self.camera is not None and self.camera.lens is not None:
            size = self.camera.size_for(*size)
        for name, value, usual in zip(("width", "height"), size, (DEFAULT_WIDTH, DEFAULT_HEIGHT), strict=True):
            object.__setattr__(self, name, usual if value is None else value)
        if self.look_at is not None and self.eye is None:
            raise SceneError("a camera with look_at needs an eye")
        if self.side is not None and (self.eye is not None or self.camera is not None):
            other = "an eye" if self.camera is None else "a camera"
            raise SceneError(f"the side '{self.side}' and {other} were given: take one of them out")
        if self.projection is not None and self.fov != DEFAULT_FOV:
            raise SceneError("fov is that of a perspective camera: take it out, or the projection")
        check_focus(self.projection, self.aperture)
        if self.samples is not None and self.samples > 1 and self.shading in REPORT_SHADINGS:
            raise SceneError(
                f"the shading '{self.shading}' has one sample, the centre of each pixel, and not {self.samples:,}: "
                "studio, ao and path take more"
            )

    def changed(self, **changes: Any) -> View:
        """Return the view with other settings.

        One way to choose the camera takes the place of another: a `side` that of an `eye`, a `camera` that of both;
        and a `noise` that of `samples`.
        Members of a group have its name before theirs: `light_direction`, `wireframe_width`.

        Raises
        ------
        SceneError
            There is no such setting, or a value is wrong.

        Examples
        --------
        >>> import clbvh
        >>> view = clbvh.View(eye=(0, 0, 5)).changed(side="top", wireframe_width=2)
        >>> view.eye is None, view.wireframe.width
        (True, 2.0)
        """
        if not changes:
            return self
        left_out: set[str] = set()
        for chosen in _CAMERA_CHOICES:
            if any(changes.get(name) is not None for name in chosen):
                left_out = left_out.union(*_CAMERA_CHOICES) - chosen
        if changes.get("fov") is not None:
            left_out.add("projection")
        if changes.get("projection") not in (None, "perspective"):
            left_out.add("fov")
        camera = changes.get("camera", self.camera)
        if getattr(camera, "lens", None) is not None and not {"camera", "width", "height"}.isdisjoint(changes):
            left_out |= {"width", "height"}
        if changes.get("noise"):
            left_out.add("samples")
        defaults = {name: DEFAULT_FOV if name == "fov" else None for name in left_out - changes.keys()}
        return change_settings(self, defaults | changes)

    @property
    def sample_count(self) -> int:
        """The samples that each pixel gets, at most."""
        if self.samples is not None:
            return self.samples
        is_adaptive = self.noise > 0 and self.shading == "path"
        return _MOST_NOISY_SAMPLES if is_adaptive else _DEFAULT_SAMPLES.get(self.shading, 1)

    @property
    def curve(self) -> str:
        """The name of the tone curve."""
        return self.tone_curve or ("filmic" if self.shading == "path" else "linear")
