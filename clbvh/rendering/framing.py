"""Cameras that see a whole mesh or scene: from one side, or from all sides during a turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from .camera import DEFAULT_FOV, DEFAULT_UP, Camera, check_fov
from .scene_extent import SceneExtent
from .vectors import Vector, as_vector
from .view_bounds import Turn, View, ViewBounds

# Vertices per step when a mesh is framed: 10 MB at a time.
_CHUNK_VERTICES = 2**17


def frame_mesh(
    mesh: Mesh | SceneExtent,
    *,
    aspect: float,
    up: Vector = DEFAULT_UP,
    fov: float = DEFAULT_FOV,
    eye: Vector | None = None,
) -> Camera:
    """Return a camera that sees all of a mesh from a three-quarter view, as close as possible.

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

    Notes
    -----
    The nearest position for the direction of view is exact: a point at (x, y, z) along right, up and forward is inside
    the picture if abs(x - eye_x) <= (z - eye_z) tan(fov / 2), and likewise for y; the tightest of these bounds over all
    points give eye_x, eye_y and eye_z in closed form.
    """
    check_fov(fov)
    if eye is not None:
        return Camera(eye, as_vector(mesh.origin), up, fov)
    view = View.from_three_quarters(aspect, up, fov)
    return view.find_camera(_bound(view, mesh), mesh, up, fov)


def frame_turn(mesh: Mesh | SceneExtent, *, aspect: float, up: Vector = DEFAULT_UP, fov: float = DEFAULT_FOV) -> Camera:
    """Return a camera that sees all of a mesh while it orbits the axis `up` through the middle of the mesh's box.

    Parameters
    ----------
    mesh, aspect, up, fov
        See `frame_mesh`.

    Notes
    -----
    As exact as `frame_mesh`: each point moves on a circle around the axis, and the bounds over a circle of radius r at
    height h are linear in r and h.
    """
    check_fov(fov)
    turn = Turn.from_three_quarters(aspect, up, fov)
    return turn.find_camera(_bound(turn, mesh), mesh, up, fov)


def _bound(view: View | Turn, mesh: Mesh | SceneExtent) -> ViewBounds:
    """Return the bounds of all vertices, or of all that a scene holds."""
    if isinstance(mesh, SceneExtent):
        return view.bounds_of(mesh.largest(view.reaches()))
    bounds = ViewBounds()
    for begin in range(0, len(mesh.local_vertices), _CHUNK_VERTICES):
        points: NDArray[np.float64] = mesh.local_vertices[begin : begin + _CHUNK_VERTICES].astype(np.float64)
        view.include(bounds, points)
    return bounds
