"""The direction that is up in a picture, where it is to be guessed from what the picture shows."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh
from ..geometry.up import Y_UP, Z_UP, find_up, guess_up_of_points, sample_points
from .vectors import Vector
from .view_bounds import SceneExtent

if TYPE_CHECKING:
    from .scene import Scene

AUTO: Literal["auto"] = "auto"

# Instances and points that a guess looks at, over a scene; spread evenly.
_INSTANCES = 1000
_POINTS = 60_000


class FoundUp(NamedTuple):
    """The direction that is up, and what the user should know of it; None where nothing was guessed."""

    vector: Vector
    note: str | None


def find_upright(scene: Scene, extent: Mesh | SceneExtent) -> FoundUp:
    """Return the direction that is up in a picture of a mesh, or of all that a scene holds.

    Parameters
    ----------
    scene : Scene
        Its `up` is returned as it is, unless it is ``"auto"``: see `clbvh.geometry.up.find_up`. A camera that looks
        along the guess has the other axis.
    extent : Mesh or SceneExtent
        A mesh's name may end in the suffix of its file.

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.rendering.upright import find_upright
    >>> find_upright(clbvh.Scene(up="auto"), clbvh.make_shape("terrain", triangles=2000)).note
    'y is up: the mesh is flat along y, like a landscape; --up 0,0,1 turns it'
    """
    if not isinstance(scene.up, str):
        return FoundUp(scene.up, None)
    if isinstance(extent, Mesh):
        found = find_up(PurePath(extent.name).suffix, extent)
    else:
        found = guess_up_of_points(_sample_scene(extent), _find_format(extent))
    if scene.eye is not None:
        target = extent.origin if scene.look_at is None else np.asarray(scene.look_at, np.float64)
        if not np.cross(target - np.asarray(scene.eye, np.float64), found.vector).any():
            return FoundUp(Z_UP if found.vector == Y_UP else Y_UP, None)
    other = "0,0,1" if found.vector == Y_UP else "0,1,0"
    return FoundUp(found.vector, f"{found.reason}; --up {other} turns it" if found.is_guess else None)


def known_up(scene: Scene) -> Vector:
    """Return the `up` of a scene that is a direction; raise `SceneError` where it is still to be guessed."""
    if isinstance(scene.up, str):
        raise SceneError('up is "auto" here, where a direction is needed: give three numbers')
    return scene.up


def _find_format(extent: SceneExtent) -> str:
    """Return the suffix of all meshes of a scene, whose names may end in those of their files; empty if they differ."""
    suffixes = {PurePath(shape.name).suffix.lower() for shape in extent.shapes if isinstance(shape, Mesh)}
    return suffixes.pop() if len(suffixes) == 1 else ""


def _sample_scene(extent: SceneExtent) -> NDArray[np.float64]:
    """Return points on the instances of a scene, (n, 3)."""
    chosen = range(0, len(extent.geometry_ids), -(-len(extent.geometry_ids) // _INSTANCES))
    points = []
    for instance in chosen:
        shape, transform = extent.shapes[extent.geometry_ids[instance]], extent.transforms[instance]
        most = max(1, _POINTS // len(chosen))
        local = (
            sample_points(shape, most)
            if isinstance(shape, Mesh)
            else shape.local_centres[:: -(-shape.prim_count // most)].astype(np.float64)
        )
        points.append((shape.origin + local / shape.scale) @ transform[:3, :3].T + transform[:3, 3])
    return np.concatenate(points)
