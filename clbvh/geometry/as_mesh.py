"""A `Mesh` of anything that describes one: an object of trimesh, pyvista, Open3D or meshio, a path, or two arrays.

Owns the list of accepted types. Objects are known by their attributes: none of the libraries is imported.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MeshError
from .loading.file_mesh import PointCloudError, Problems, finish_looks, join_channels, spread_colours
from .loading.load import load_mesh
from .loading.polygons import cut_polygons
from .loading.trimesh import HasGraph, HasTriangles, describe, join_graph, mesh_of_object, read_graph, reading
from .mesh import Mesh
from .spheres import Shape, Spheres


@runtime_checkable
class HasPoints(Protocol):
    """An object with points and cells, such as a `pyvista.PolyData` or a `meshio.Mesh`."""

    @property
    def points(self) -> Any:
        """(V, 3) float."""


MeshLike: TypeAlias = Mesh | HasTriangles | HasGraph | HasPoints | str | os.PathLike[str] | tuple[ArrayLike, ArrayLike]
"""Anything that describes a mesh: a `Mesh`, the path of a mesh file, ``(vertices, faces)``, or an object of trimesh,
pyvista, Open3D or meshio; see `docs/meshes.md`."""


def as_mesh(thing: MeshLike, *, or_else: str = "") -> Mesh:
    """Return the mesh that a user means.

    Parameters
    ----------
    thing : Mesh, str, path, (vertices, faces), or an object of trimesh, pyvista, Open3D or meshio
        A `Mesh` is returned as it is; arrays are checked and copied, a file is loaded. A `trimesh.Scene` becomes one
        mesh whose parts are its nodes; a grid of pyvista its surface. Polygons of pyvista are cut by its own
        `triangulate`, those of meshio as those of files.
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
    if not isinstance(thing, type):
        name = type(thing).__name__
        if isinstance(thing, HasGraph):
            return join_graph(read_graph(thing))
        if isinstance(thing, HasTriangles):
            return mesh_of_object(thing, name)
        with reading(thing):
            arrays = _read_arrays(thing, name)
        if arrays is not None:
            return _with_colours(Mesh.from_arrays(*arrays[:2], name=name), *arrays[2:])
    raise MeshError(
        f"expected {or_else}{', ' if or_else else ''}a clbvh.Mesh, a mesh of trimesh, pyvista, Open3D or meshio, the "
        f"path of a mesh file, or a pair (vertices, faces), not {describe(thing)}"
    )


def as_shape(thing: Shape | MeshLike, *, or_else: str = "clbvh.Spheres") -> Shape:
    """Return the mesh that a user means, or the spheres; those around the points of a cloud, see `Spheres.from_points`.

    Parameters
    ----------
    thing : Spheres, or as `as_mesh`
        Also a file without faces, and a point cloud of trimesh or Open3D.
    or_else : str, optional
        See `as_mesh`.

    Raises
    ------
    MeshError
        As `as_mesh`.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.geometry.as_mesh import as_shape
    >>> as_shape(trimesh.PointCloud([[0, 0, 0], [1, 0, 0], [0, 1, 0]]))
    Spheres('PointCloud', count=3)
    """
    if isinstance(thing, Spheres):
        return thing
    if type(thing).__name__ == "PointCloud":  # of trimesh, and of both kinds of Open3D
        return Spheres.from_points(_read_cloud(thing), name="PointCloud")
    try:
        return as_mesh(thing, or_else=or_else)
    except PointCloudError as error:
        return spheres_of_file(error, thing)  # type: ignore[arg-type]  # only files have points alone


def spheres_of_file(error: PointCloudError, path: str | os.PathLike[str], radius: ArrayLike | None = None) -> Spheres:
    """Return the spheres around the points of a file that has no faces, as its loader said."""
    points, colours = np.asarray(error.cloud.vertices), error.cloud.point_colours
    return Spheres.from_points(points, radius, colours=colours, name=Path(path).name)


def _read_cloud(thing: Any) -> Any:
    """Return a point cloud with the attributes of those of trimesh."""
    if not hasattr(thing, "point"):
        return thing
    colours = thing.point.colors.cpu().numpy() if "colors" in thing.point else None
    return SimpleNamespace(vertices=thing.point.positions.cpu().numpy(), colors=colours)


def _read_arrays(thing: Any, name: str) -> tuple[Any, ...] | None:
    """Return vertices and triangles of an object, and perhaps colours of vertices; None if it has no known kind."""

    def has(*names: str) -> bool:
        return all(hasattr(thing, each) for each in names)

    if has("points", "faces"):  # pyvista.PolyData
        return _read_polygons(thing)
    if has("extract_surface"):  # grids and blocks of pyvista
        try:
            surface = thing.extract_surface(algorithm=None)  # without it pyvista 0.47 warns of a change
        except TypeError:
            surface = thing.extract_surface()
        return _read_polygons(surface)
    if has("points", "cells"):  # meshio.Mesh
        points = np.asarray(thing.points)
        return points, _cut_cells(thing.cells, points, name)
    if has("vertices", "triangles"):  # open3d.geometry.TriangleMesh
        return np.asarray(thing.vertices), np.asarray(thing.triangles), np.asarray(getattr(thing, "vertex_colors", ()))
    if has("vertex", "triangle"):  # open3d.t.geometry.TriangleMesh
        colours = thing.vertex.colors.cpu().numpy() if "colors" in thing.vertex else ()
        return thing.vertex.positions.cpu().numpy(), thing.triangle.indices.cpu().numpy(), colours
    return None


def _read_polygons(thing: Any) -> tuple[Any, NDArray[np.integer]]:
    """Return points and triangles of an object of pyvista, whose `faces` list the number of corners before each."""
    faces = np.asarray(thing.faces)
    if len(getattr(thing, "strips", ())) or len(faces) % 4 or (faces[::4] != 3).any():
        thing = thing.triangulate()
        faces = np.asarray(thing.faces)
    return thing.points, faces.reshape(-1, 4)[:, 1:]


def _cut_cells(blocks: Iterable[Any], points: NDArray[Any], name: str) -> NDArray[np.integer]:
    """Return the triangles of blocks of cells, in their order; lines, points and volumes have none."""
    faces: list[NDArray[np.integer]] = []
    kinds = []
    for block in blocks:
        kinds.append(str(block.type))
        if block.type in ("triangle", "quad", "polygon"):
            corners = np.asarray(block.data)
            ids = corners.ravel()
            faces.append(cut_polygons(ids, np.full(len(corners), corners.shape[1]), ids, points))
        elif block.dim == 2:
            raise MeshError(f"{name}: cells of the type {block.type} are not read: triangle, quad and polygon are")
    if not faces:
        among = ", ".join(kinds) or "none"
        raise MeshError(f"{name}: there are no triangle, quad or polygon cells among these: {among}")
    return np.concatenate(faces)


def _with_colours(mesh: Mesh, colours: Any = ()) -> Mesh:
    """Return a mesh with sRGB colours of its vertices, (V, 3) float from 0 to 1, if there are any that can be used."""
    problems = Problems()
    with problems.drop("the colours"):
        if len(colours):
            spread = spread_colours(join_channels(list(np.transpose(colours)), colours.dtype), mesh.faces)
            mesh = dataclasses.replace(mesh, appearance=finish_looks({"colours": spread}, []))
    problems.warn(mesh.name)
    return mesh
