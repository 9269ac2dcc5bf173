"""Settings of a picture and their checks: light, samples, wireframe."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

from ..errors import SceneError
from ..structs import REPORT_SHADINGS, TONE_CURVES
from .vectors import Vector, check_vector, is_finite_number


@dataclass(frozen=True)
class Light:
    """A directed light, and ambient light from the sky and the ground. Colours are linear, 0 to 1.

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
    >>> picture = clbvh.render(clbvh.Scene(clbvh.MeshSource(shape="icosphere", triangles=1000), light=light))
    """

    direction: Vector | None = None
    colour: Vector = (0.92, 0.88, 0.82)
    sky: Vector = (0.19, 0.21, 0.24)
    ground: Vector = (0.07, 0.065, 0.06)

    def __post_init__(self) -> None:
        for name in ("colour", "sky", "ground"):
            check_vector(f"the light's {name}", getattr(self, name))
        if self.direction is not None:
            check_vector("the light's direction", self.direction)
            if not any(self.direction):
                raise SceneError("the light's direction must not be zero")

    def with_direction(self, direction: Vector | None) -> Light:
        """Return a copy with another direction.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Light().with_direction((0, 1, 0)).direction
        (0, 1, 0)
        """
        return dataclasses.replace(self, direction=direction)


DEFAULT_LIGHT = Light()


DEFAULT_CREASE_ANGLE = 40.0
DEFAULT_CHANNELS = ("rgb", "alpha", "depth", "normal", "instance_id")  # of `render_images`
DEFAULT_BOUNCES = 12

# Enough for edges without steps and for soft shadows with little noise: 0.6 s for 800 x 450 on a 2-core x86-64 server.
_DEFAULT_SAMPLES = {"studio": 16, "ao": 16, "path": 64}

# More would leave the numbers of the sample points.
MAX_SAMPLES = 2**24
_MAX_SEED = 2**32 - 1
_MAX_BOUNCES = 1000

# Light of 2^100 times the usual strength is still a float32.
_MAX_EXPOSURE = 100.0

# Samples are compared with it in float32.
_MAX_CLAMP = 1e30

# With the brightest pixels of an environment, still a float32.
_MAX_STRENGTH = 1e10


def check_sampling(scene: Any) -> None:
    """Raise `SceneError` for a setting that is out of range."""
    if scene.samples is not None:
        _check_integer("samples", scene.samples, 1, MAX_SAMPLES)
        if scene.samples > 1 and scene.shading in REPORT_SHADINGS:
            raise SceneError(
                f"the shading '{scene.shading}' has one sample, the centre of each pixel, and not {scene.samples:,}: "
                "studio, ao and path take more"
            )
    _check_integer("seed", scene.seed, 0, _MAX_SEED)
    _check_integer("max_bounces", scene.max_bounces, 0, _MAX_BOUNCES)
    _check_number("smooth", scene.smooth, 0.0, 180.0)
    _check_number("exposure", scene.exposure, -_MAX_EXPOSURE, _MAX_EXPOSURE)
    _check_number("environment_strength", scene.environment_strength, 0.0, _MAX_STRENGTH)
    if not is_finite_number(scene.environment_rotation):
        raise SceneError(f"environment_rotation must be a finite number of degrees, not {scene.environment_rotation!r}")
    if scene.clamp is not None and not (is_finite_number(scene.clamp) and 0 < scene.clamp <= _MAX_CLAMP):
        raise SceneError(f"clamp must be a number above 0 and up to {_MAX_CLAMP:g}, or None, not {scene.clamp!r}")
    for name in ("ground", "transparent"):
        if not isinstance(getattr(scene, name), bool) and not (name == "ground" and scene.ground is None):
            raise SceneError(f"{name} must be True or False, not {getattr(scene, name)!r}")
    if scene.tone_curve is not None and scene.tone_curve not in TONE_CURVES:
        raise SceneError(f"the tone curve must be one of {', '.join(TONE_CURVES)}, not {scene.tone_curve!r}")


def find_sample_count(scene: Any) -> int:
    """Return how many samples each pixel gets."""
    return _DEFAULT_SAMPLES.get(scene.shading, 1) if scene.samples is None else scene.samples


def find_tone_curve(scene: Any) -> str:
    """Return the name of the tone curve."""
    return scene.tone_curve or ("filmic" if scene.shading == "path" else "linear")


def _check_integer(name: str, value: object, least: int, most: int) -> None:
    if isinstance(value, bool) or not isinstance(value, Integral) or not least <= int(value) <= most:
        raise SceneError(f"{name} must be a whole number from {least} to {most:,}, not {value!r}")


def _check_number(name: str, value: object, least: float, most: float) -> None:
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if not is_number or not least <= float(value) <= most:  # type: ignore[arg-type]
        raise SceneError(f"{name} must be a number from {least:g} to {most:g}, not {value!r}")


DEFAULT_WIDTH = 1.0
BLACK = (0.0, 0.0, 0.0)

_MAX_WIDTH = 1000.0


@dataclass(frozen=True)
class Wireframe:
    """Lines along the edges of triangles, drawn over what the camera shows; spheres have none.

    Attributes
    ----------
    width : float, pixels
        Above 0, at most 1000. It is the same at any distance.
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
    >>> picture = clbvh.render(ball, wireframe=clbvh.Wireframe(width=2), width=64, height=48)
    >>> bool(picture.rgb.mean() < clbvh.render(ball, width=64, height=48).rgb.mean())
    True
    """

    width: float = DEFAULT_WIDTH
    colour: Vector = BLACK

    def __post_init__(self) -> None:
        width = self.width
        if isinstance(width, bool) or not isinstance(width, Real) or not 0 < float(width) <= _MAX_WIDTH:
            raise SceneError(f"the width of a wireframe must be above 0, and at most 1000 pixels, not {width!r}")
        check_vector("the colour of a wireframe", self.colour)
        if not all(0 <= part <= 1 for part in self.colour):
            raise SceneError(f"the colour of a wireframe must be three numbers from 0 to 1, not {self.colour}")
