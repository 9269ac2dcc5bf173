"""A scene in the form that the render kernel takes: one `structs.VIEW`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh
from ..structs import SHADINGS, TONE_CURVES, VIEW
from .camera import Camera
from .cut import set_cut
from .film.ground import GROUND_GAP, Ground
from .film.settings import find_tone_curve
from .projection import Fisheye, Panorama
from .scene import Scene
from .upright import known_up
from .view_projection import set_projection
from .wireframe import set_wireframe

# Largest distance from the mesh to the eye, in sizes of the mesh: well within float32.
_MOST_DISTANCE = 1e30

# The direction to the automatic light, in the camera's frame: left, above, towards the viewer.
_LIGHT_LEFT, _LIGHT_ABOVE, _LIGHT_TOWARDS = 0.60, 0.78, 0.62

# The same in the shading `studio`: more from the side and from above, so that the faces of a part differ.
_KEY_LEFT, _KEY_ABOVE, _KEY_TOWARDS = 0.70, 0.85, 0.45

# Tangent of half the angle of the soft light: that of a large lamp.
_LIGHT_SPREAD = 0.1

# Surfaces within this share of the half diagonal of the box around all objects keep ambient light off each other:
# without a limit, a closed room would have none.
_OCCLUSION_REACH = 0.4

# More than float32 rounds off a radius.
_ROUNDED_UP = 1.0 + 1e-5


def make_view(
    scene: Scene,
    camera: Camera,
    mesh: Mesh,
    local_box: NDArray[np.floating] | None = None,
    ground: Ground | None = None,
    framed_box: NDArray[np.floating] | None = None,
) -> NDArray[np.void]:
    """Return the view of a mesh, (1,) `structs.VIEW`.

    Parameters
    ----------
    scene : Scene
    camera : Camera
        In the scene's coordinates; the view is in the mesh's local ones.
    mesh : Mesh
    local_box : (2, 3) float, local coordinates, optional
        The box around all objects; by default the mesh's.
    ground : Ground, optional
        In the scene's coordinates.
    framed_box : (2, 3) float, local coordinates, optional
        The box around what counts, see `Scene.frame`; by default `local_box`. A depth picture shows its depths, which
        are distances from the eye for a fisheye and a panorama.

    Raises
    ------
    SceneError
        The eye is too far away for float32, or the aspect ratio is not that of the camera's lens.
    """
    view = np.zeros(1, VIEW)
    right, up, forward = camera.axes()
    eye = _locate_eye(camera, mesh)
    view["eye"] = eye
    view["eye_low"] = eye - view["eye"]
    view["optical_axis"] = forward
    set_projection(view, camera, mesh.scale, scene.width, scene.height)

    view["to_light"] = _light_direction(scene, right, up, forward)
    view["light_colour"] = scene.light.colour
    view["to_sky"] = sky_direction(scene, camera)
    view["sky_colour"] = scene.light.sky
    view["ground_colour"] = scene.light.ground
    view["surface_colour"] = scene.surface
    view["background_top"], view["background_bottom"] = scene.background

    box = (mesh.local_box if local_box is None else local_box).astype(np.float64)
    is_round = isinstance(camera.projection, Fisheye | Panorama)
    framed = box if framed_box is None else framed_box.astype(np.float64)
    nearest, farthest = _range_around(framed, eye) if is_round else _range_along(framed, eye, forward)
    # A mesh without depth is drawn white.
    view["depth_near"], view["depth_far"] = nearest, farthest if farthest > nearest else nearest + 1.0
    view["width"], view["height"] = scene.width, scene.height
    view["shading"] = SHADINGS[scene.shading]
    half_diagonal = np.linalg.norm(np.ptp(box, axis=0)) / 2
    if ground is not None:
        gap = GROUND_GAP * half_diagonal if scene.shading == "path" else 0.0
        view["ground_point"] = mesh.to_local(ground.point) - gap * ground.normal
        view["ground_normal"], view["ground_radius"] = ground.normal, ground.radius * mesh.scale
    view["objects_centre"], view["objects_radius"] = box.mean(axis=0), _ROUNDED_UP * half_diagonal
    view["objects_half_size"] = _ROUNDED_UP * np.ptp(box, axis=0) / 2 + (_ROUNDED_UP - 1.0) * half_diagonal
    view["occlusion_reach"] = _OCCLUSION_REACH * np.linalg.norm(np.ptp(framed, axis=0)) / 2
    view["has_sun"] = any(scene.light.colour)
    view["is_headlight"] = scene.light.direction is None and bool(((framed[0] < eye) & (eye < framed[1])).all())
    view["light_spread"], view["exposure"] = _LIGHT_SPREAD, 2.0**scene.exposure
    secant = np.hypot(1.0, _LIGHT_SPREAD)
    view["sun_width"] = _LIGHT_SPREAD**2 / (secant * (secant + 1.0))
    view["most_light"] = np.inf if scene.clamp is None else scene.clamp
    view["tone_curve"] = TONE_CURVES[find_tone_curve(scene)]
    if scene.cut is not None:
        set_cut(view, scene.cut, eye, (mesh.to_local(scene.cut.first), mesh.to_local(scene.cut.second)))
    if scene.wireframe is not None:
        set_wireframe(view, scene.wireframe, scene)
    view["is_transparent"], view["seed"], view["most_bounces"] = scene.transparent, scene.seed, scene.max_bounces
    return view


def sky_direction(scene: Scene, camera: Camera) -> NDArray[np.float64]:
    """Return (3,) float64: the unit vector upwards in the scene."""
    # The `up` of a camera with a lens, and that of one that looks straight down, is the picture's, not the world's.
    is_of_world = camera.lens is None and scene.view is None
    to_sky = np.asarray(camera.up if is_of_world else known_up(scene), np.float64)
    return to_sky / np.linalg.norm(to_sky)


def _locate_eye(camera: Camera, mesh: Mesh) -> NDArray[np.float64]:
    """Return the eye in local coordinates."""
    with np.errstate(over="ignore"):
        eye = mesh.to_local(camera.eye)
        distance = np.abs(eye).max()
    if not distance < _MOST_DISTANCE:
        raise SceneError(
            f"the camera's eye {camera.eye} is {distance:.0e} sizes of the mesh away from it, and a picture has room "
            f"for {_MOST_DISTANCE:.0e}: move it closer"
        )
    return eye


def _light_direction(
    scene: Scene, right: NDArray[np.float64], up: NDArray[np.float64], forward: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the unit vector towards the light."""
    if scene.light.direction is None:
        is_studio = scene.shading == "studio"
        left, above, near = (
            (_KEY_LEFT, _KEY_ABOVE, _KEY_TOWARDS) if is_studio else (_LIGHT_LEFT, _LIGHT_ABOVE, _LIGHT_TOWARDS)
        )
        towards = above * up - left * right - near * forward
    else:
        towards = np.asarray(scene.light.direction, np.float64)
    return towards / np.linalg.norm(towards)


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
