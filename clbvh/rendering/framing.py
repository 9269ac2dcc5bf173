"""Cameras that see a whole mesh or scene: from one side, or from all sides during a turn."""

from __future__ import annotations

import numpy as np

from ..geometry import Mesh
from .camera import DEFAULT_FOV, DEFAULT_UP, Camera, check_fov
from .centring import find_eye
from .extent_bounds import find_bounds
from .projection import Projection
from .scene_extent import SceneExtent
from .standard_views import find_sides
from .vectors import Vector, as_vector
from .view_bounds import Turn, View
from .wide_framing import frame_wide, frame_wide_turn


def frame_mesh(
    mesh: Mesh | SceneExtent,
    *,
    aspect: float,
    up: Vector = DEFAULT_UP,
    fov: float = DEFAULT_FOV,
    eye: Vector | None = None,
    projection: Projection | None = None,
    side: str | None = None,
) -> Camera:
    """Return a camera that sees all of a mesh from a three-quarter view or a standard one, as close as possible.

    Parameters
    ----------
    mesh : Mesh or SceneExtent
        A mesh, or all that a scene holds.
    aspect : float
        Width of the picture divided by its height.
    up : (3,) float
        The direction that is up in the picture.
    fov : float
        Vertical field of view in degrees.
    eye : (3,) float, optional
        A fixed position; the camera looks at the middle of the mesh's box.
    projection : Orthographic, Fisheye, Panorama or None
        None: perspective. The others have no `fov`; a panorama looks from the middle of the mesh's box.
    side : str, optional
        One of `STANDARD_VIEWS`, in place of the three-quarter view and without an `eye`.

    Notes
    -----
    The nearest position for the direction of view is exact: a point at (x, y, z) along right, up and forward is inside
    the picture if abs(x - eye_x) <= (z - eye_z) tan(fov / 2), and likewise for y; the tightest of these bounds over all
    points give eye_z in closed form, and either eye_x or eye_y. The other one is chosen by `find_eye`.
    """
    check_fov(fov)
    if projection is not None:
        return frame_wide(mesh, projection, aspect=aspect, up=up, eye=eye, side=side)
    if eye is not None:
        return Camera(eye, as_vector(mesh.origin), up, fov)
    view = View.from_side(side, aspect, up, fov)
    return _frame(view, mesh, find_sides(side, up)[1], fov)


def measure_side(mesh: Mesh | SceneExtent, side: str | None, up: Vector = DEFAULT_UP) -> tuple[float, float]:
    """Return the width and the height of a mesh as an orthographic picture from a side shows it, in its units."""
    view = View.from_side(side, 1.0, up, DEFAULT_FOV)._replace(tangents=np.zeros(2))
    bounds = find_bounds(view, mesh)
    width, height = ((bounds.highest - bounds.lowest) / mesh.scale).tolist()
    return width, height


def frame_turn(
    mesh: Mesh | SceneExtent,
    *,
    aspect: float,
    up: Vector = DEFAULT_UP,
    fov: float = DEFAULT_FOV,
    projection: Projection | None = None,
) -> Camera:
    """Return a camera that sees all of a mesh while it orbits the axis `up` through the middle of the mesh's box.

    Parameters
    ----------
    mesh, aspect, up, fov, projection
        See `frame_mesh`.

    Raises
    ------
    SceneError
        For a panorama, which sees all sides at once.

    Notes
    -----
    As exact as `frame_mesh`: each point moves on a circle around the axis, and the bounds over a circle of radius r at
    height h are linear in r and h.
    """
    check_fov(fov)
    if projection is not None:
        return frame_wide_turn(mesh, projection, aspect=aspect, up=up)
    turn = Turn.from_three_quarters(aspect, up, fov)
    return _frame(turn, mesh, up, fov)


def _frame(view: View | Turn, mesh: Mesh | SceneExtent, up: Vector, fov: float) -> Camera:
    eye, bounds = find_eye(view, mesh)
    return view.make_camera(eye, bounds, mesh, up, fov)
