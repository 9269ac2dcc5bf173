"""Makes a `Mesh` of anything that describes one: an object, a path, or two arrays.

Owns the list of accepted types. Must not know what is done with the mesh.
"""

from __future__ import annotations

import dataclasses
import os
from typing import Any, Protocol, TypeAlias, runtime_checkable

from numpy.typing import ArrayLike

from ..errors import MeshError
from .loading.load import load_mesh
from .mesh import Mesh
from .trimesh_looks import read_trimesh_looks

_MAX_SHOWN = 60  # characters of a wrong value in a message


@runtime_checkable
class HasTriangles(Protocol):
    """An object with the arrays of a triangle mesh, such as a `trimesh.Trimesh`."""

    @property
    def vertices(self) -> Any:
        """(V, 3) float."""

    @property
    def faces(self) -> Any:
        """(F, 3) int."""


MeshLike: TypeAlias = Mesh | HasTriangles | str | os.PathLike[str] | tuple[ArrayLike, ArrayLike]
"""Anything that describes a mesh: a `Mesh`, a `trimesh.Trimesh`, the path of a mesh file, or ``(vertices, faces)``."""


def as_mesh(thing: MeshLike, *, or_else: str = "") -> Mesh:
    """Return the mesh that a user means.

    Parameters
    ----------
    thing : Mesh, trimesh.Trimesh, str, path or (vertices, faces)
        A `Mesh` is returned as it is; arrays are checked and copied, a file is loaded.
    or_else : str, optional
        Other types that the caller accepts, for the error's message: ``"a clbvh.Bvh"``.

    Raises
    ------
    MeshError
        The argument has another type, or it is no valid mesh.

    Examples
    --------
    >>> from clbvh.geometry.as_mesh import as_mesh
    >>> as_mesh(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    Mesh('mesh', vertices=3, faces=1)
    """
    if isinstance(thing, Mesh):
        return thing
    if isinstance(thing, str | os.PathLike):
        return load_mesh(thing)
    if isinstance(thing, tuple | list) and len(thing) == 2:
        return Mesh.from_arrays(*thing)
    if isinstance(thing, HasTriangles) and not isinstance(thing, type):
        return mesh_of_object(thing, type(thing).__name__)
    raise MeshError(
        f"expected {or_else}{', ' if or_else else ''}a clbvh.Mesh, a trimesh.Trimesh, the path of a mesh file, or a "
        f"pair (vertices, faces), not {_describe(thing)}"
    )


def mesh_of_object(thing: HasTriangles, name: str) -> Mesh:
    """Return the mesh of an object such as a `trimesh.Trimesh`, with its colours, textures and materials.

    Raises
    ------
    MeshError
        It is no valid mesh.
    """
    mesh = Mesh.from_arrays(thing.vertices, thing.faces, name=name)
    appearance = read_trimesh_looks(thing, mesh.faces, name)
    return mesh if appearance is None else dataclasses.replace(mesh, appearance=appearance)


def _describe(thing: object) -> str:
    """Return the type of a wrong value, with the value where it is short."""
    kind = type(thing)
    if kind.__module__ != "builtins":
        return f"a {kind.__module__.partition('.')[0]}.{kind.__qualname__}"
    text = repr(thing)
    return f"{kind.__qualname__} {text}" if len(text) <= _MAX_SHOWN else f"a {kind.__qualname__}"
