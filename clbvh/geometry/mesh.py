"""A triangle mesh in memory, checked, and once more in the local coordinates that trees and devices use.

Owns the checks of vertices and faces and the map to local coordinates. Must not know of files or trees.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from operator import index
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..device.host.loops import Loops
from ..errors import MeshError
from ..kinds import TRIANGLES, Kind
from ..support.memory import check_memory
from .appearance.appearance import Appearance, check_fit
from .arrays import as_array, check_numbers, copy_as_float64
from .coincident import Coincidence, find_coincidence
from .corners import Corners
from .local_frame import LocalFrame, find_bounds, shift_and_scale
from .scales import Frame, find_mesh_frame, move_frame
from .topology import NORMALS, CornerFaces, find_corner_faces, find_points, find_vertex_normals, is_closed

# A tree over n primitives has up to 2n - 1 nodes, and both are counted in int32.
MAX_FACE_COUNT = 2**30

# Vertices in the file's coordinates and in local ones.
_BYTES_PER_VERTEX = 36

_LOOPS = Loops("geometry/faces")


class Part(NamedTuple):
    """A part of a mesh: the faces from `begin` up to, but without, `end`.

    Examples
    --------
    >>> import clbvh
    >>> corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> halves = [clbvh.Part("lower", 0, 1), clbvh.Part("upper", 1, 2)]
    >>> square = clbvh.Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], parts=halves)
    >>> upper = square.parts[1]
    >>> square.faces[upper.begin : upper.end]
    array([[0, 2, 3]], dtype=int32)
    """

    name: str
    begin: int
    end: int


@dataclass(frozen=True, eq=False)
class Mesh(LocalFrame):
    """Triangles in the file's coordinates, and in local coordinates.

    Scans in survey coordinates lie millions of units from zero, where float32 resolves half a unit; and a square of
    1e-20 is no float32 at all. Trees and devices therefore work in local coordinates: the centre of the mesh's box is
    moved to zero in float64, the mesh is scaled by a power of two to a size of about 1, which rounds nothing, and only
    then come the 24 bits of float32. They decide which triangle a ray hits. Where it is hit is computed in float64, on
    the vertices as they are in the file.

    Attributes
    ----------
    vertices : (V, 3) float64, the file's coordinates
    faces : (F, 3) int32, vertex indices
        In the order of the file, after polygons are cut into triangles.
    local_vertices : (V, 3) float32, local coordinates
        ``(vertices - origin) * scale``; the largest half side of their box is from 0.5 to 1, or 0.
    origin : (3,) float64, the file's coordinates
        Centre of the box around the vertices that faces use; see `spans_scales`.
    scale : float
        A power of two: local units in one unit of the file.
    name : str
        The name of the mesh in messages and reports.
    appearance : Appearance, or None
        Normals, colours, texture coordinates and materials, for pictures. No tree depends on it.
    parts : tuple of Part
        Named ranges of faces that follow each other and cover all of them; none for a mesh without parts. Names need
        not be unique. `Hits.part_id` says which of them was hit.

    Notes
    -----
    Build one with `Mesh.from_arrays` or `clbvh.load_mesh`: they check their arguments, which the constructor does not.
    36 bytes per vertex and 12 per face, without the appearance.

    Examples
    --------
    >>> import clbvh
    >>> square = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    >>> square
    Mesh('mesh', vertices=4, faces=2)
    >>> square.origin
    array([0.5, 0.5, 0. ])
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    local_vertices: NDArray[np.float32]
    origin: NDArray[np.float64]
    scale: float
    name: str = field(default="mesh")
    appearance: Appearance | None = None
    parts: tuple[Part, ...] = ()

    @classmethod
    def from_arrays(
        cls,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        name: str = "mesh",
        appearance: Appearance | None = None,
        parts: Iterable[tuple[str, int, int]] = (),
    ) -> Mesh:
        """Check the arrays, copy them, and find the local coordinates.

        Parameters
        ----------
        vertices : (V, 3) float
            Any floating-point or integer dtype and any unit.
        faces : (F, 3) int
            Vertex indices from 0 to V - 1.
        name : str, optional
            The name of the mesh in messages and reports.
        appearance : Appearance, optional
            Normals, colours, texture coordinates and materials, for pictures.
        parts : sequence of Part, optional
            Each begins where the one before it ends, the first with face 0, and the last ends with the last face.

        Returns
        -------
        Mesh

        Raises
        ------
        MeshError
            Wrong shape or dtype, no faces, too many faces, a NaN or infinite coordinate, a vertex index out of range,
            the appearance of another number of faces, parts that do not cover the faces one after the other, or a box
            whose sides float64 cannot scale: smaller than 1e-150 or larger than 1e150. The message names the first
            fault.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="corner")
        Mesh('corner', vertices=3, faces=1)
        >>> clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]])
        Traceback (most recent call last):
        clbvh.errors.MeshError: mesh: face 0 refers to vertex 3, but there are 3 vertices (0 to 2)
        """
        checked_vertices = _check_vertices(vertices, name)
        checked_faces = _check_faces(faces, len(checked_vertices), name)
        frame = find_mesh_frame(checked_vertices, checked_faces, name)
        check_fit(appearance, len(checked_faces), name, has_corners=True)
        checked_parts = _check_parts(parts, len(checked_faces), name)
        mesh = cls(checked_vertices, checked_faces, *frame[:3], name, appearance, checked_parts)
        return mesh._keep(frame)

    def with_vertices(self, vertices: ArrayLike) -> Mesh:
        """Return a mesh of the same faces with moved vertices.

        Parameters
        ----------
        vertices : (V, 3) float, the file's coordinates
            The same number as before.

        Returns
        -------
        Mesh
            With its own origin and scale; it shares the array of faces, the parts, and the appearance except for its
            normals, which the movement has made wrong.

        Raises
        ------
        MeshError
            Another number of vertices, or vertices that `from_arrays` refuses.

        Examples
        --------
        >>> import clbvh
        >>> sphere = clbvh.make_shape("icosphere", triangles=1000)
        >>> flattened = sphere.with_vertices(sphere.vertices * [1, 0.5, 1])
        >>> flattened.faces is sphere.faces
        True
        """
        checked_vertices = _check_vertices(vertices, self.name)
        if len(checked_vertices) != len(self.vertices):
            raise MeshError(
                f"{self.name}: {len(checked_vertices):,} vertices cannot replace the mesh's {len(self.vertices):,}"
            )
        appearance = None if self.appearance is None else self.appearance.without_normals()
        sized_scale = vars(self).get("_sized_scale")
        if sized_scale is None or self.spans_scales:
            frame = find_mesh_frame(checked_vertices, self.faces, self.name)
        else:
            frame = move_frame(
                checked_vertices, self.faces, self.name, loose=self.loose_vertices, sized_scale=sized_scale
            )
        moved = Mesh(checked_vertices, self.faces, *frame[:3], self.name, appearance, self.parts)._keep(frame)
        for name in ("_is_joined", "corner_faces"):  # cached: they depend on the faces alone
            if name in vars(self):
                vars(moved)[name] = vars(self)[name]
        return moved

    def _keep(self, frame: Frame) -> Self:
        """Keep what the search for local coordinates has found besides them; pickles do without."""
        names = {"spans_scales": frame.spans_scales, "loose_vertices": frame.loose_vertices}
        vars(self).update(names, _sized_scale=frame.sized_scale)
        return self

    @property
    def face_count(self) -> int:
        """Number of triangles, degenerate ones included."""
        return len(self.faces)

    @property
    def kind(self) -> Kind:
        """Of its primitives: triangles."""
        return TRIANGLES

    @property
    def prim_count(self) -> int:
        """Number of primitives: its triangles."""
        return len(self.faces)

    @property
    def balls(self) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Centres and radii of balls that reach as far as the shape: the vertices, without radii."""
        return self.vertices, None

    def find_corners(self) -> Corners:
        """Return the local vertices and the faces.

        Examples
        --------
        >>> import clbvh
        >>> square = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
        >>> square.find_corners().ids
        array([[0, 1, 2],
               [0, 2, 3]], dtype=int32)
        """
        return Corners(self.local_vertices, self.faces)

    @cached_property
    def local_box(self) -> NDArray[np.float32]:
        """(2, 3) float32: the least and the greatest local coordinates of the vertices."""
        return np.stack(find_bounds(self.local_vertices))

    @cached_property
    def degenerate_faces(self) -> NDArray[np.bool_]:
        """(F,) bool: true for triangles whose corners lie on one line or in one point, in `decisive_vertices`.

        Such a triangle stays in the mesh, so that face numbers keep their meaning, but no ray ever hits it.
        """
        degenerate = np.empty(self.face_count, np.bool_)
        vertices = self.decisive_vertices
        find = _LOOPS.find_degenerate if vertices.dtype == np.float32 else _LOOPS.find_degenerate_of_doubles
        find(vertices, self.faces, degenerate)
        return degenerate

    @cached_property
    def spans_scales(self) -> bool:
        """Whether parts of the mesh are so small beside the whole that float64 decides what rays hit.

        That is a vertex all of whose faces are smaller than 2^-16 of half the box. A mesh of `with_vertices` is looked
        at again once its box has grown to twice the size.

        Examples
        --------
        >>> import clbvh
        >>> ball = clbvh.make_shape("icosphere", triangles=320)
        >>> ball.spans_scales
        False
        """
        return find_mesh_frame(self.vertices, self.faces, self.name).spans_scales

    @property
    def decisive_vertices(self) -> NDArray[np.floating]:
        """(V, 3) float: the vertices that decide which points and triangles are the same, or none.

        Those in local coordinates; in float64, as they are in the file, if the mesh spans scales.
        """
        return self.vertices if self.spans_scales else self.local_vertices

    @cached_property
    def is_watertight(self) -> bool:
        """Whether the surface encloses a volume: every edge belongs to two triangles, or to another even number.

        Vertices with equal `decisive_vertices` count as one, so a file may repeat them for each triangle. The
        orientation of triangles does not matter. Faces that coincide count as often as they are there or once, see
        `Tracer.contains`. About 0.1 s for 871,306 triangles, once; and not again for the meshes of `with_vertices` if
        the faces share vertices along all edges, which no movement can open.
        """
        return self._is_even or bool(self.coincidence.is_closed)

    @cached_property
    def _is_even(self) -> bool:
        return self._is_joined or is_closed(find_points(self.decisive_vertices).ids[self.faces])

    @cached_property
    def _is_joined(self) -> bool:
        return is_closed(self.faces)

    @cached_property
    def coincidence(self) -> Coincidence:
        """What faces with the same three corners mean for the inside."""
        return find_coincidence(self.vertices, self.local_vertices, self.faces, lambda: self._is_even)

    @cached_property
    def corner_faces(self) -> CornerFaces:
        """The faces around each vertex. About 0.2 s for 871,306 triangles, once; `with_vertices` hands them on."""
        return find_corner_faces(find_points(self.vertices), self.faces)

    @cached_property
    def margins(self) -> NDArray[np.float32]:
        """(F, 4) float32: what start points of rays have found of each side of the faces; 0 before."""
        return np.zeros((self.face_count, 4), np.float32)

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) float64, the file's coordinates: the least and the greatest ones of the vertices, loose ones too."""
        return np.stack(find_bounds(self.vertices))

    @cached_property
    def area(self) -> float:
        """Sum of `face_areas`, in the square of the file's unit."""
        return float(self.face_areas.sum())

    @cached_property
    def face_areas(self) -> NDArray[np.float64]:
        """(F,) float64: areas in the square of the file's unit. Computed once; 8 bytes per face.

        Examples
        --------
        >>> import clbvh
        >>> square = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1, 2], [0, 0, 1]])
        >>> square.face_areas
        array([0.5, 0. ])
        """
        corners = self.vertices[self.faces]
        sides = (np.roll(corners, -1, axis=1) - corners) * self.scale
        # Without the longest side: the product of the two long sides of a needle would cancel to its small area.
        longest = np.abs(sides).sum(axis=2).argmax(axis=1)
        one, other = (sides[np.arange(len(sides)), longest - number] for number in (1, 2))
        x, y, z = np.cross(one, other).T
        # By `hypot`: the squares of a small triangle's product would underflow.
        return np.hypot(np.hypot(x, y), z) / 2 / self.scale / self.scale

    @cached_property
    def face_normals(self) -> NDArray[np.float64]:
        """(F, 3) float64: unit normals, on the side from which a face's corners run anticlockwise; 0 without an area.

        Computed once; 24 bytes per face. `Hits.normals` are the same of the faces that were hit, but for slivers.

        Examples
        --------
        >>> import clbvh
        >>> square = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1, 2], [0, 2, 1], [0, 0, 1]])
        >>> square.face_normals
        array([[ 0.,  0.,  1.],
               [ 0.,  0., -1.],
               [ 0.,  0.,  0.]])
        """
        normals = np.empty((self.face_count, 3))
        NORMALS.measure_faces(
            self.vertices, self.faces, self.scale, 0, self.face_count, normals, np.empty((self.face_count, 3))
        )
        return normals

    @cached_property
    def loose_vertices(self) -> NDArray[np.int64]:
        """(n,) int64, ascending: the vertices of no face."""
        is_loose = np.ones(len(self.vertices), np.bool_)
        is_loose[self.faces] = False
        return np.flatnonzero(is_loose)

    @cached_property
    def vertex_normals(self) -> NDArray[np.float64]:
        """(V, 3) float64: unit normals at the vertices: the mean of the faces around, weighted by their angles.

        On the side from which the corners of faces run anticlockwise. Vertices with equal coordinates share one, so a
        file may repeat them for each triangle; of faces that coincide, the first counts. Where the normals around
        cancel each other, it is that of the face with the widest angle there; where no face around has an area, that of
        a neighbour along these faces. NaN for a vertex in no face, see `loose_vertices`. Computed once; 24 bytes per
        vertex.

        Examples
        --------
        >>> import clbvh
        >>> corner = clbvh.Mesh.from_arrays(
        ...     [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 3, 2], [0, 1, 3]], name="corner"
        ... )
        >>> corner.vertex_normals[0].round(3)
        array([-0.577, -0.577, -0.577])
        """
        return find_vertex_normals(self.vertices, self.faces, self.scale, self.coincidence.repeated)

    @cached_property
    def fingerprint(self) -> bytes:
        """32 bytes that identify faces and local vertices: the SHA-256 of their counts and bytes.

        Nothing else determines a tree: not the name, nor where the mesh is, nor its unit. About 1.8 GB/s where the
        processor has instructions for it, a quarter elsewhere.
        """
        digest = hashlib.sha256(f"{len(self.vertices)} vertices, {len(self.faces)} faces;".encode())
        digest.update(np.ascontiguousarray(self.local_vertices, "<f4").data)
        digest.update(np.ascontiguousarray(self.faces, "<i4").data)
        return digest.digest()

    @property
    def degenerate_count(self) -> int:
        """Number of triangles without area."""
        return int(self.degenerate_faces.sum())

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the mesh to a file: completely or not at all.

        An `AppearanceWarning` says what the file does not keep; `Scene.save` keeps all.

        Parameters
        ----------
        path : str or path
            The suffix decides:

            - ``.ply`` (binary): each float64 coordinate, colours of vertices or faces, texture coordinates, and normals
              where a vertex has one.
            - ``.obj``: each float64 coordinate, colours of vertices, normals, texture coordinates and parts.
            - ``.stl`` (binary): the corners of each face in float32.

            None has materials and textures.

        Raises
        ------
        ConfigError
            Another suffix, or the file cannot be written there.
        OSError
            The disk is full, for example.

        Examples
        --------
        >>> import clbvh
        >>> import tempfile
        >>> from pathlib import Path
        >>> knot = clbvh.make_shape("knot", triangles=1000)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     knot.save(Path(folder, "knot.ply"))
        ...     bool((clbvh.load_mesh(Path(folder, "knot.ply")).vertices == knot.vertices).all())
        True
        """
        from .write_mesh import write_mesh  # most meshes are not saved

        write_mesh(path, self)

    def to_trimesh(self) -> Any:
        """Return a `trimesh.Trimesh` of the same vertices and faces, copied, in the same order; without appearance.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.make_shape("icosphere", triangles=320).to_trimesh().is_watertight
        True
        """
        import trimesh  # takes 0.3 s

        return trimesh.Trimesh(self.vertices.copy(), self.faces.copy(), process=False)

    def __repr__(self) -> str:
        parts = f", parts={len(self.parts):,}" if self.parts else ""
        return f"Mesh({self.name!r}, vertices={len(self.vertices):,}, faces={self.face_count:,}{parts})"


def mesh_in_frame(
    vertices: ArrayLike, faces: ArrayLike, origin: NDArray[np.float64], scale: float, *, name: str
) -> Mesh:
    """Return a part of a larger mesh, whose origin and scale it has; checked as by `Mesh.from_arrays`.

    Its local vertices are those of the larger mesh, to the last bit.
    """
    checked_vertices = _check_vertices(vertices, name)
    checked_faces = _check_faces(faces, len(checked_vertices), name)
    local = shift_and_scale(checked_vertices, origin, scale)
    mesh = Mesh(checked_vertices, checked_faces, local, origin, scale, name)
    vars(mesh)["spans_scales"] = False  # float32 of the larger mesh decides, in all of its parts
    return mesh


def _check_vertices(vertices: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return the vertices as a finite (V, 3) float64 array of our own."""
    array = as_array(vertices, f"{name}: vertices")
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"{name}: vertices must have shape (V, 3), not {array.shape}")
    check_numbers(array, f"{name}: vertices")
    if len(array) == 0:
        raise MeshError(f"{name}: the mesh has no vertices")
    check_memory(f"a mesh of {len(array):,} vertices", len(array) * _BYTES_PER_VERTEX, MeshError)
    copied = copy_as_float64(array)
    finite = np.isfinite(copied)
    if not finite.all():
        vertex, axis = np.argwhere(~finite)[0]
        coordinate = f"{'xyz'[axis]} = {array[vertex, axis]}"
        raise MeshError(f"{name}: vertex {vertex} has a coordinate that is not finite: {coordinate}")
    return copied


def _check_faces(faces: ArrayLike, vertex_count: int, name: str) -> NDArray[np.int32]:
    """Return the faces as an (F, 3) int32 array of valid vertex indices, of our own."""
    array = as_array(faces, f"{name}: faces")
    if array.size == 0:
        raise MeshError(f"{name}: the mesh has no faces")
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"{name}: faces must have shape (F, 3), not {array.shape}")
    if not np.issubdtype(array.dtype, np.integer):
        raise MeshError(f"{name}: faces must be integers, not {array.dtype}")
    if len(array) > MAX_FACE_COUNT:
        raise MeshError(f"{name}: the mesh has {len(array):,} faces; the limit is {MAX_FACE_COUNT:,}")
    if array.min() < 0 or array.max() >= vertex_count:
        face, corner = np.argwhere((array < 0) | (array >= vertex_count))[0]
        raise MeshError(
            f"{name}: face {face} refers to vertex {array[face, corner]}, but there are {vertex_count} vertices "
            f"(0 to {vertex_count - 1})"
        )
    return np.array(array, np.int32, order="C")


def _check_parts(parts: Iterable[tuple[str, int, int]], face_count: int, name: str) -> tuple[Part, ...]:
    """Return the parts, none of which is empty; between them they have each face once."""
    try:
        checked = tuple(Part(str(part), index(begin), index(end)) for part, begin, end in parts)
    except (TypeError, ValueError):
        raise MeshError(f"{name}: parts must be a sequence of clbvh.Part(name, begin, end)") from None
    for part, begin in zip(checked, [0, *(part.end for part in checked)], strict=False):
        if part.begin != begin or not begin < part.end <= face_count:
            raise MeshError(
                f"{name}: the part {part.name!r} has the faces {part.begin:,} to {part.end:,}, but the part before it "
                f"ends at {begin:,}, and the mesh has {face_count:,} faces"
            )
    if checked and checked[-1].end != face_count:
        raise MeshError(f"{name}: the parts end at face {checked[-1].end:,}, but the mesh has {face_count:,} faces")
    return checked


# What a triangle takes while its mesh is made, and what a vertex takes in a mesh with more of them. Traced for 400,000
# triangles of each shape: up to 138 bytes.
_BYTES_PER_FACE = 150


def check_face_count(face_count: int, vertex_count: int = 0) -> None:
    """Raise `MeshError` if a mesh would be too large; for checks before arrays for it are allocated."""
    if face_count > MAX_FACE_COUNT:
        raise MeshError(f"{face_count:,} triangles are too many: the limit is {MAX_FACE_COUNT:,}")
    size = f"{face_count:,} triangles" + (f" and {vertex_count:,} vertices" if vertex_count else "")
    check_memory(size, max(face_count, vertex_count) * _BYTES_PER_FACE, MeshError)
