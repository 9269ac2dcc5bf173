"""The settings of pictures from many samples: their checks and their defaults."""

from __future__ import annotations

from numbers import Integral, Real
from typing import TYPE_CHECKING

from ...errors import SceneError
from ...structs import REPORT_SHADINGS, TONE_CURVES
from ..finite_number import is_finite_number

if TYPE_CHECKING:
    from ..scene import Scene

DEFAULT_CREASE_ANGLE = 40.0
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


def check_sampling(scene: Scene) -> None:
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


def find_sample_count(scene: Scene) -> int:
    """Return how many samples each pixel gets."""
    return _DEFAULT_SAMPLES.get(scene.shading, 1) if scene.samples is None else scene.samples


def find_tone_curve(scene: Scene) -> str:
    """Return the name of the tone curve."""
    return scene.tone_curve or ("filmic" if scene.shading == "path" else "linear")


def _check_integer(name: str, value: object, least: int, most: int) -> None:
    if isinstance(value, bool) or not isinstance(value, Integral) or not least <= int(value) <= most:
        raise SceneError(f"{name} must be a whole number from {least} to {most:,}, not {value!r}")


def _check_number(name: str, value: object, least: float, most: float) -> None:
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if not is_number or not least <= float(value) <= most:  # type: ignore[arg-type]
        raise SceneError(f"{name} must be a number from {least:g} to {most:g}, not {value!r}")
