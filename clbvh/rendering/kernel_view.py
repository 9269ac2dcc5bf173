"""A view in the form that the render kernels take: one `structs.VIEW`, with its projection, cut, lines and ground."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..choices import REPORT_SHADINGS, SHADINGS, TONE_CURVES
from ..errors import SceneError
from ..geometry.appearance.srgb import linear_to_srgb
from ..geometry.spheres import Bounded
from ..structs import CUTS, PROJECTIONS, VIEW
from ..support.settings import Vector
from ..views.cameras.camera import Camera
from ..views.cameras.lens import window_of
from ..views.cameras.projection import Fisheye, Orthographic, Panorama, name_of
from ..views.cameras.rays import find_ray_model
from ..views.ground import GROUND_GAP, Ground, sky_direction
from ..views.view import View

# Largest distance from the mesh to the eye, in sizes of the mesh: well within float32.
_MOST_DISTANCE = 1e30

# The direction to the automatic light, in the camera's frame: left, above, towards the viewer.
_LIGHT = 0.60, 0.78, 0.62

# The same in the shading `studio`: more from the side and from above, so that the faces of a part differ.
_KEY_LIGHT = 0.70, 0.85, 0.45

# Tangent of half the angle of the soft light: that of a large lamp.
_LIGHT_SPREAD = 0.1

# Surfaces within this share of the half diagonal of the box around all objects keep ambient light off each other:
# without a limit, a closed room would have none.
_OCCLUSION_REACH = 0.4

# More than float32 rounds off a radius.
_ROUNDED_UP = 1.0 + 1e-5


def make_kernel_view(
    view: View,
    camera: Camera,
    space: Bounded,
    local_box: NDArray[np.floating] | None = None,
    ground: Ground | None = None,
    framed_box: NDArray[np.floating] | None = None,
    is_studio_lit: bool = False,
) -> NDArray[np.void]:
    """Return a view for the kernels, (1,) `structs.VIEW`.

    Parameters
    ----------
    view : View
        Complete, see `ViewFinder`.
    camera : Camera
        In the scene's coordinates; the view is in local ones.
    space : Mesh, Spheres or Boxes
        Has the local coordinates.
    local_box : (2, 3) float, local coordinates, optional
        The box around all objects; by default that of `space`.
    ground : Ground, optional
        In the scene's coordinates.
    framed_box : (2, 3) float, local coordinates, optional
        The box around what counts, see `View.frame`; by default `local_box`. A depth picture shows its depths, which
        are distances from the eye for a fisheye and a panorama.
    is_studio_lit : bool
        See `is_lit_as_studio`.

    Raises
    ------
    SceneError
        The eye is too far away for float32, or the aspect ratio is not that of the camera's lens.
    """
    kernel_view = np.zeros(1, VIEW)
    right, up, forward = camera.axes()
    eye = _locate_eye(camera, space)
    kernel_view["eye"] = eye
    kernel_view["eye_low"] = eye - kernel_view["eye"]
    kernel_view["optical_axis"] = forward
    _set_projection(kernel_view, camera, space.scale, view.width, view.height)

    kernel_view["is_studio_lit"] = is_studio_lit
    if view.light.direction is None:
        left, above, near = _KEY_LIGHT if is_studio_lit or view.shading == "studio" else _LIGHT
        towards = above * up - left * right - near * forward
    else:
        towards = np.asarray(view.light.direction, np.float64)
    kernel_view["to_light"] = towards / np.linalg.norm(towards)
    kernel_view["light_colour"] = view.light.colour
    kernel_view["to_sky"] = sky_direction(view, camera)
    kernel_view["sky_colour"] = view.light.sky
    kernel_view["ground_colour"] = view.light.ground
    kernel_view["surface_colour"] = view.surface
    kernel_view["background_top"], kernel_view["background_bottom"] = view.background

    box = (space.local_box if local_box is None else local_box).astype(np.float64)
    is_round = isinstance(camera.projection, Fisheye | Panorama)
    framed = box if framed_box is None else framed_box.astype(np.float64)
    nearest, farthest = _range_around(framed, eye) if is_round else _range_along(framed, eye, forward)
    # A mesh without depth is drawn white.
    kernel_view["depth_near"], kernel_view["depth_far"] = nearest, farthest if farthest > nearest else nearest + 1.0
    kernel_view["width"], kernel_view["height"] = view.width, view.height
    kernel_view["shading"] = SHADINGS[view.shading]
    half_diagonal = np.linalg.norm(np.ptp(box, axis=0)) / 2
    if ground is not None:
        gap = GROUND_GAP * half_diagonal if view.shading == "path" else 0.0
        kernel_view["ground_point"] = space.to_local(ground.point) - gap * ground.normal
        kernel_view["ground_normal"], kernel_view["ground_radius"] = ground.normal, ground.radius * space.scale
    kernel_view["objects_centre"], kernel_view["objects_radius"] = box.mean(axis=0), _ROUNDED_UP * half_diagonal
    kernel_view["objects_half_size"] = _ROUNDED_UP * np.ptp(box, axis=0) / 2 + (_ROUNDED_UP - 1.0) * half_diagonal
    kernel_view["occlusion_reach"] = _OCCLUSION_REACH * np.linalg.norm(np.ptp(framed, axis=0)) / 2
    kernel_view["has_sun"] = any(view.light.colour)
    kernel_view["is_headlight"] = view.light.direction is None and bool(((framed[0] < eye) & (eye < framed[1])).all())
    kernel_view["light_spread"], kernel_view["exposure"] = _LIGHT_SPREAD, 2.0**view.exposure
    secant = np.hypot(1.0, _LIGHT_SPREAD)
    kernel_view["sun_width"] = _LIGHT_SPREAD**2 / (secant * (secant + 1.0))
    kernel_view["most_light"] = np.inf if view.clamp is None else view.clamp
    kernel_view["tone_curve"] = TONE_CURVES[view.curve]
    if (cut := view.cut) is not None:
        kernel_view["cut"] = CUTS[cut.kind]
        with np.errstate(over="ignore"):
            if cut.kind == "plane":
                kernel_view["cut_normal"], kernel_view["cut_height"] = (
                    cut.normal,
                    (eye - space.to_local(cut.first)) @ cut.normal,
                )
            else:
                kernel_view["cut_lower"], kernel_view["cut_upper"] = (
                    space.to_local(cut.first) - eye,
                    space.to_local(cut.second) - eye,
                )
        section = view.section
        kernel_view["has_section"], kernel_view["section_hatch"] = section.fill, section.hatch
        kernel_view["section_colour"] = _drawn_colour(view, section.colour)
    if view.wireframe is not None:
        kernel_view["line_width"] = view.wireframe.width
        kernel_view["line_colour"] = _drawn_colour(view, view.wireframe.colour)
    kernel_view["is_transparent"], kernel_view["seed"] = view.transparent, view.seed
    kernel_view["most_bounces"] = view.max_bounces
    return kernel_view


def _drawn_colour(view: View, colour: Vector) -> NDArray[np.float64]:
    """Return a linear colour, as it is after exposure and tone curve, in the numbers that the shading computes."""
    linear = np.asarray(colour, np.float64)
    if view.shading in REPORT_SHADINGS:
        return linear_to_srgb(linear)
    light = _invert_filmic(linear) if view.curve == "filmic" else linear
    return np.asarray(light / 2.0**view.exposure)


def _locate_eye(camera: Camera, space: Bounded) -> NDArray[np.float64]:
    """Return the eye in local coordinates."""
    with np.errstate(over="ignore"):
        eye = space.to_local(camera.eye)
        distance = np.abs(eye).max()
    if not distance < _MOST_DISTANCE:
        raise SceneError(
            f"the camera's eye {camera.eye} is {distance:.0e} sizes of the mesh away from it, and a picture has room "
            f"for {_MOST_DISTANCE:.0e}: move it closer"
        )
    return eye


def _range_along(
    box: NDArray[np.float64], eye: NDArray[np.float64], forward: NDArray[np.float64]
) -> tuple[float, float]:
    """Return the nearest and the farthest distance of a box along the line of sight, in local units."""
    lower, upper = box
    nearest = float(np.where(forward > 0, lower, upper) @ forward - eye @ forward)
    farthest = float(np.where(forward > 0, upper, lower) @ forward - eye @ forward)
    return max(nearest, 0.0), farthest


def _range_around(box: NDArray[np.float64], eye: NDArray[np.float64]) -> tuple[float, float]:
    """Return the nearest and the farthest distance of a box from the eye, in local units."""
    lower, upper = box
    nearest = np.linalg.norm(np.maximum(np.maximum(lower - eye, eye - upper), 0.0))
    return float(nearest), float(np.linalg.norm(np.maximum(upper - eye, eye - lower)))


# Largest extent of a lens or of parallel rays, in sizes of the mesh: well within float32.
_MOST_EXTENT = 1e30

_Axes = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def _set_projection(kernel_view: NDArray[np.void], camera: Camera, scale: float, width: int, height: int) -> None:
    """Write the fields of the projection and of the lens into a view.

    Parameters
    ----------
    kernel_view : (1,) `structs.VIEW`
    camera : Camera
    scale : float
        Local units in one unit of the scene.
    width, height : int, pixels

    Raises
    ------
    SceneError
        A length is too large for float32, or the aspect ratio is not that of the camera's lens.
    """
    model = find_ray_model(camera.projection, camera.lens, camera.fov, width, height)
    right, up, middle = axes = camera.axes()
    window, kind = model.window, name_of(camera.projection)
    match camera.projection:
        case None if model.distortion is None:
            middle, right, up = _span_picture(camera, width, height, axes)
        case None:
            kind = "distorted"
            kernel_view["centre"] = window.centre_x, window.centre_y
            kernel_view["half_size"] = window.half_width, window.half_height
            kernel_view["shear"] = window.shear
            kernel_view["distortion"] = model.distortion
        case Orthographic():
            right, up = window.half_width * scale * right, window.half_height * scale * up
        case Fisheye(degrees):
            kernel_view["half_size"] = window.half_width, window.half_height
            kernel_view["half_angle"] = math.radians(degrees) / 2 / (2 * math.pi)
    kernel_view["projection"] = PROJECTIONS[kind]
    kernel_view["forward"] = middle
    kernel_view["forward_low"] = middle - kernel_view["forward"]
    kernel_view["right"], kernel_view["up"] = right, up
    radius = camera.aperture / 2 * scale
    if radius != 0:
        kernel_view["has_lens"] = 1
        with np.errstate(over="ignore"):  # refused below
            kernel_view["lens_right"], kernel_view["lens_up"] = radius * axes[0], radius * axes[1]
            kernel_view["inverse_focus"] = 1 / (camera.focus * scale)
    extents = [np.abs(kernel_view[name]).max() for name in ("right", "up", "lens_right", "lens_up")]
    if not max(extents) < _MOST_EXTENT:
        raise SceneError(f"the camera's height or aperture is more than {_MOST_EXTENT:.0e} sizes of the mesh")


def _span_picture(camera: Camera, width: int, height: int, axes: _Axes) -> _Axes:
    """Return the middle of the picture in the plane at distance 1 from the eye, and its halves right and up."""
    right, up, forward = axes
    if camera.lens is None:
        half_height = math.tan(math.radians(camera.fov) / 2)
        # The order of these products determines the last bits of pictures.
        return forward, right * half_height * width / height, up * half_height
    window = window_of(camera.lens.resized(width, height))
    # One unit upwards, which skew also moves to the side.
    upwards = up + window.shear * right
    middle = forward + window.centre_x * right + window.centre_y * upwards
    return middle, window.half_width * right, window.half_height * upwards


def _invert_filmic(colour: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the light that the filmic curve maps to a colour; see cl/film/tone.cl."""
    square, linear, constant = 2.51 - 2.43 * colour, 0.03 - 0.59 * colour, -0.14 * colour
    return (np.sqrt(linear * linear - 4.0 * square * constant) - linear) / (2.0 * square)
