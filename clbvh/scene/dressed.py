"""The shapes of a scene in the materials of its instances: what pictures make their tables of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.dressed import with_material
from ..geometry.shape import Shape
from .state import SceneState


def dress_shapes(state: SceneState) -> tuple[tuple[Shape, ...], NDArray[np.integer]]:
    """Return shapes with their looks, and the shape of each instance.

    Returns
    -------
    shapes : tuple of Mesh or Spheres
        The geometries, by their ids; then one for each pair of a geometry and a material that instances have of their
        own. It shares the arrays of its geometry.
    shape_ids : (n,) int

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.scene.dressed import dress_shapes
    >>> scene = clbvh.Scene()
    >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320))
    >>> plain, golden = scene.place(ball), scene.place(ball, material=clbvh.Material(metallic=1.0))
    >>> shapes, shape_ids = dress_shapes(scene.snapshot())
    >>> len(shapes), shape_ids
    (2, array([0, 1]))
    """
    shape_ids = state.geometry_ids.astype(np.int64)
    own = np.flatnonzero(state.material_ids >= 0)
    if len(own) == 0:
        return state.shapes, shape_ids
    pairs = np.stack((state.geometry_ids[own], state.material_ids[own]), axis=1)
    chosen, numbers = np.unique(pairs, axis=0, return_inverse=True)
    shape_ids[own] = len(state.shapes) + numbers.reshape(-1)
    dressed = (
        with_material(state.shapes[geometry], state.materials[material]) for geometry, material in chosen.tolist()
    )
    return (*state.shapes, *dressed), shape_ids
