"""The handle of a geometry in a scene. Owns nothing: the scene's store does."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..geometry.shape import Shape


@dataclass(frozen=True, eq=False, repr=False)
class Geometry:
    """A shape that a scene holds; `Scene.add` makes it, and `Scene.place` places it.

    Attributes
    ----------
    id : int
        Its number in the scene, from 0 in the order of adding: the `geometry_id` of hits.
    name : str
        Unique among the geometries of the scene.
    shape : Mesh or Spheres
        In its own coordinates, those of the file.

    Examples
    --------
    >>> import clbvh
    >>> scene = clbvh.Scene()
    >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320))
    >>> ball
    Geometry(0, 'icosphere', Mesh('icosphere', vertices=162, faces=320))
    """

    id: int
    name: str
    shape: Shape
    owner: Any = field(repr=False)

    def __repr__(self) -> str:
        return f"Geometry({self.id}, {self.name!r}, {self.shape!r})"
