"""Objects of a scene file are loaded and placed in a scene.

Owns the order of the work and the names of instances. Objects of the same source share one geometry, and its tree.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, InternalError, MeshError, SceneError
from ..geometry.mesh import Mesh
from ..scene.geometry import Geometry
from ..scene.names import UniqueNames
from .repeat import Scatter
from .scene import Scene
from .scene_object import SceneObject
from .upright import known_up


def load_objects(scene: Scene, objects: Sequence[SceneObject]) -> None:
    """Load objects and place them in a scene, in their order.

    The instances of an object are named after its label: ``tree``, ``tree 2``, ``tree 3``.

    Parameters
    ----------
    scene : Scene
        Changed.
    objects : sequence of SceneObject
        As `read_objects` returns them.

    Raises
    ------
    MeshError, SceneError, ConfigError
        A source cannot be loaded, or a transform cannot be used; the message names the object.
    """
    names = UniqueNames("an object")
    for found in objects:
        names.add(found.label)
    geometries: list[tuple[SceneObject, Geometry]] = []
    for found in objects:
        try:
            geometry = _add(scene, found, geometries)
            geometries.append((found, geometry))
            # Products of numbers that are too large are not finite, and refused when they are placed.
            with np.errstate(over="ignore", invalid="ignore"):
                matrices = _place(found, geometries, scene)
            copies = [found.label, *(names.add_numbered(found.label) for _ in range(1, len(matrices)))]
            scene.place_many(
                geometry, matrices, names=copies, mask=found.mask, colour=found.colour, material=found.material
            )
        except (MeshError, SceneError, ConfigError) as error:
            raise type(error)(f"the object '{found.label}': {error}") from error


def _add(scene: Scene, found: SceneObject, others: list[tuple[SceneObject, Geometry]]) -> Geometry:
    """Return the geometry of an object: that of another one with the same source, or a new one."""
    for other, geometry in others:
        if other.source == found.source:
            return geometry
    return scene.add(found.source.load(), name=found.label)


def _place(found: SceneObject, geometries: list[tuple[SceneObject, Geometry]], scene: Scene) -> NDArray[np.float64]:
    """Return the transforms of an object's copies, (n, 4, 4)."""
    if found.repeat is None:
        return found.matrix[None]
    if not isinstance(found.repeat, Scatter):
        return found.repeat.matrices(found.matrix)
    target, geometry = next(pair for pair in geometries if pair[0].label == found.repeat.on)
    surface = geometry.shape
    if not isinstance(surface, Mesh):
        raise InternalError(f"copies are scattered on '{target.label}', which is {surface!r} and no mesh")
    vertices = surface.vertices @ target.matrix[:3, :3].T + target.matrix[:3, 3]
    if not np.isfinite(vertices).all():
        raise MeshError(f"the surface of '{target.label}' has coordinates that are not finite in the scene")
    faces = surface.faces
    # A mirrored triangle is seen from its other side, unless its corners are turned round.
    if np.linalg.slogdet(target.matrix[:3, :3])[0] < 0:
        faces = faces[:, ::-1]
    return found.repeat.matrices(found.matrix, vertices, faces, known_up(scene))
