"""A mesh on disk as shards: compact pieces of about equally many triangles, each of which fits the memory.

Owns the folder of shards, how a mesh is cut, and the checks of what is read. Must not know of trees, rays and devices.

A mesh is cut in halves again and again, in a histogram of its triangles' centroids: so the boxes of shards overlap by
little more than a triangle. Ranges of Morton codes would be simpler, but the box of a range that crosses a middle plane
may be as large as the mesh: rays met 4.3 of 10 shards of a terrain, instead of 1.07.

Every shard is in the local coordinates of the whole mesh: its float32 vertices have the same bytes there, and so do the
decisions that are made from them. A folder holds ``shards.json`` and for each shard an archive of numpy with the arrays
``prim_ids``, the faces' numbers in the whole mesh in ascending order, ``faces`` and ``vertices``, those that it uses.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..choices import DEFAULT_SHARD_TRIANGLES
from ..device.host.loops import Loops
from ..errors import ConfigError, MeshError, shorten_message
from ..support.archive import read_members
from ..support.files import as_path, open_regular, read_errors_as, read_regular, temporary_folder
from .as_mesh import MeshLike, as_mesh
from .loading.ply import map_triangles
from .local_frame import find_bounds, find_frame
from .mesh import MAX_FACE_COUNT, Mesh, mesh_in_frame

INDEX_FILE = "shards.json"
FORMAT_VERSION = 1

# Cells of the histogram along each axis of a cube around the mesh.
_AXIS_CELLS = 1 << 7

# From a cell to the next one along x, y and z.
_CELL_STEPS = np.array([1, _AXIS_CELLS, _AXIS_CELLS**2], np.int32)

# Vertices or faces processed at a time: about 100 MB of temporary arrays.
_CHUNK_ROWS = 1 << 20

_LOOPS = Loops("geometry/faces")

_ARRAYS = {"prim_ids": np.int32, "faces": np.int32, "vertices": np.float64}


@dataclass(frozen=True, eq=False)
class Shard:
    """A shard of a mesh, on disk.

    Attributes
    ----------
    path : Path
        Of its file.
    triangle_count : int
    box : (2, 3) float32 or None
        The least and the greatest local coordinates of its triangles that have an area; None if none has.
    fingerprint : str
        That of its mesh, in hexadecimal digits.
    mesh_name : str
        Of the whole mesh.
    mesh_triangle_count : int
    origin : (3,) float64
    scale : float
        Those of the whole mesh.
    half : (3,) float64, local coordinates
        The largest absolute coordinates of its triangles.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.shard_mesh(clbvh.make_shape("icosphere", triangles=1000), "parts", triangles=500)
    (Shard('shard-0000.npz', triangles=476), Shard('shard-0001.npz', triangles=504))
    """

    path: Path
    triangle_count: int
    box: NDArray[np.float32] | None
    fingerprint: str
    mesh_name: str
    mesh_triangle_count: int
    origin: NDArray[np.float64]
    scale: float
    half: NDArray[np.float64]

    def load(self) -> tuple[Mesh, NDArray[np.int32]]:
        """Return the mesh of the shard, in the local coordinates of the whole one, and (F,) int32: its faces there.

        Raises
        ------
        MeshError
            The file cannot be read, is damaged, or is not the one that ``shards.json`` describes.

        Examples
        --------
        >>> import clbvh
        >>> ball = clbvh.make_shape("icosphere", triangles=1000)
        >>> mesh, prim_ids = clbvh.shard_mesh(ball, "parts", triangles=500)[1].load()
        >>> bool((mesh.vertices[mesh.faces] == ball.vertices[ball.faces[prim_ids]]).all())
        True
        """
        with read_errors_as(MeshError, self.path), open_regular(self.path) as file:
            try:
                arrays = read_members(file)
                prim_ids, faces, vertices = (arrays[name].astype(dtype, copy=False) for name, dtype in _ARRAYS.items())
                mesh = mesh_in_frame(vertices, faces, self.origin, self.scale, name=self.mesh_name)
            except Exception as error:  # of zipfile and numpy, and our own
                detail = shorten_message(error)
                raise MeshError(f"{self.path}: the shard is damaged ({detail}): cut the mesh again") from error
        is_numbered = prim_ids.shape == (self.triangle_count,) == faces.shape[:1] and (np.diff(prim_ids) > 0).all()
        in_range = is_numbered and prim_ids[0] >= 0 and prim_ids[-1] < self.mesh_triangle_count
        if not in_range or mesh.fingerprint.hex() != self.fingerprint:
            raise MeshError(f"{self.path}: this is not the shard that {INDEX_FILE} describes: cut the mesh again")
        return mesh, prim_ids

    def __repr__(self) -> str:
        return f"Shard({self.path.name!r}, triangles={self.triangle_count:,})"


def shard_mesh(
    mesh: MeshLike, folder: str | os.PathLike[str], *, triangles: int = DEFAULT_SHARD_TRIANGLES
) -> tuple[Shard, ...]:
    """Cut a mesh into shards, compact pieces of about equally many triangles, which `ShardedTracer` reads.

    Parameters
    ----------
    mesh : MeshLike
        A binary little-endian PLY file of triangles is never in memory as a whole; any other mesh is.
    folder : str or path
        A new folder, or an empty one; it appears complete or not at all.
    triangles : int, optional
        About as many triangles has a shard. Tracing takes about 200 bytes for each.

    Returns
    -------
    tuple of Shard

    Raises
    ------
    MeshError
        See `load_mesh`.
    ConfigError
        The folder cannot be made, or has content; `triangles` is not a number of at least 1.
    OSError
        It cannot be written: the disk is full, for example.

    Notes
    -----
    The mesh is cut in halves again and again, across the longest side, in a histogram of 2^21 cells. The same mesh
    gives the same files, streamed or not. About 50 bytes on disk for each triangle, and 16 more while it runs.
    Appearance and parts are left out.

    Examples
    --------
    >>> import clbvh
    >>> terrain = clbvh.make_shape("terrain", triangles=2000)
    >>> [shard.triangle_count for shard in clbvh.shard_mesh(terrain, "parts", triangles=700)]
    [672, 656, 656]
    """
    if not isinstance(triangles, Integral) or isinstance(triangles, bool) or triangles < 1:
        raise ConfigError(f"triangles must be an integer of at least 1, not {triangles!r}")
    target = as_path(folder).absolute()
    if not target.parent.is_dir():
        raise ConfigError(f"{folder}: the folder {target.parent} does not exist")
    if target.exists() and not (target.is_dir() and not any(target.iterdir())):
        raise ConfigError(f"{folder}: this exists and is not an empty folder: give a new one")
    source = _Source.open(mesh)
    with temporary_folder(target.parent, ".clbvh-shards-") as temporary:
        made = temporary / "made"
        made.mkdir()
        _write_shards(source, made, int(triangles))
        made.replace(target)
    return read_shards(target)


class _Source(NamedTuple):
    """A mesh in memory, or in a file that is mapped: vertices (V, 3), faces (F, 3), both of any dtype."""

    vertices: NDArray[np.floating]
    faces: NDArray[np.integer]
    name: str

    @classmethod
    def open(cls, thing: MeshLike) -> _Source:
        path = Path(thing) if isinstance(thing, str | os.PathLike) else None
        mapped = None if path is None else map_triangles(path)
        if path is not None and mapped is not None:
            return cls(*mapped, path.name)
        mesh = as_mesh(thing)
        return cls(mesh.vertices, mesh.faces, mesh.name)

    def find_frame(self) -> tuple[NDArray[np.float64], float]:
        """Return the origin and the scale of the mesh, as `Mesh.from_arrays` finds them."""
        if not all(np.isfinite(part).all() for part in _chunks(self.vertices)):
            raise MeshError(f"{self.name}: a vertex has a coordinate that is not finite")
        corners = (self.vertices[faces.reshape(-1)].astype(np.float64) for faces in self.checked_faces())
        bounds = np.array([find_bounds(part) for part in corners])
        return find_frame(bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0), self.name, subject="the mesh is")

    def checked_faces(self) -> Iterator[NDArray[Any]]:
        """Yield some faces at a time, (n, 3) valid indices."""
        first = 0
        for faces in _chunks(self.faces):
            if faces.min() < 0 or faces.max() >= len(self.vertices):
                face, corner = np.argwhere((faces < 0) | (faces >= len(self.vertices)))[0]
                raise MeshError(
                    f"{self.name}: face {first + face} refers to vertex {faces[face, corner]}, but there are "
                    f"{len(self.vertices)} vertices (0 to {len(self.vertices) - 1})"
                )
            yield faces
            first += len(faces)

    def cells(self, origin: NDArray[np.float64], scale: float) -> Iterator[tuple[NDArray[Any], NDArray[np.int32]]]:
        """Yield some faces at a time, as `checked_faces`, and (n,) int32: the cells of their centroids."""
        for faces in self.checked_faces():
            centroids = sum((self.vertices[faces[:, corner]] - origin) * scale for corner in range(3)) / 3
            places = np.clip((centroids + 1) * (_AXIS_CELLS / 2), 0, _AXIS_CELLS - 1).astype(np.int32)
            yield faces, places @ _CELL_STEPS


def _chunks(rows: NDArray[Any]) -> Iterator[NDArray[Any]]:
    for begin in range(0, len(rows), _CHUNK_ROWS):
        yield np.ascontiguousarray(rows[begin : begin + _CHUNK_ROWS])


def _write_shards(source: _Source, folder: Path, triangles: int) -> None:
    """Write the files of all shards."""
    total = len(source.faces)
    if total > MAX_FACE_COUNT:
        raise MeshError(f"{source.name}: the mesh has {total:,} faces; the limit is {MAX_FACE_COUNT:,}")
    origin, scale = source.find_frame()

    # The shard of each cell of the histogram.
    counts = np.zeros(_AXIS_CELLS**3, np.int64)
    for _, cells in source.cells(origin, scale):
        counts += np.bincount(cells, minlength=len(counts))
    shard_count = -(-total // triangles)
    firsts, shares = np.zeros(len(counts), np.int32), np.ones(len(counts), np.int32)
    _share_cells(np.flatnonzero(counts), counts, 0, shard_count, firsts, shares)
    ranks = np.zeros(len(counts), np.int64)

    # Faces with their numbers, appended to a table of each shard.
    tables = [folder / f"{number}.faces" for number in range(shard_count)]
    first = 0
    for faces, cells in source.cells(origin, scale):
        numbers = np.empty(len(faces), np.int32)
        _LOOPS.find_shards(cells, counts, firsts, shares, ranks, numbers)
        rows = np.empty((len(faces), 4), np.int32)
        rows[:, 0], rows[:, 1:] = np.arange(first, first + len(faces)), faces
        order = np.argsort(numbers, kind="stable")
        begins = np.searchsorted(numbers[order], np.arange(shard_count + 1))
        for number in np.flatnonzero(np.diff(begins)).tolist():
            with tables[number].open("ab") as file:
                file.write(rows[order[begins[number] : begins[number + 1]]].data)
        first += len(faces)

    # Each shard with the vertices that it uses.
    half, described = np.zeros(3, np.float32), []
    for number, table in enumerate(tables):
        rows = np.fromfile(table, np.int32).reshape(-1, 4)
        table.unlink()
        used = np.unique(rows[:, 1:])
        faces = np.searchsorted(used, rows[:, 1:]).astype(np.int32)
        vertices = source.vertices[used].astype(np.float64)
        path = folder / f"shard-{number:04}.npz"
        np.savez(path, prim_ids=np.ascontiguousarray(rows[:, 0]), faces=faces, vertices=vertices)
        mesh = mesh_in_frame(vertices, faces, origin, scale, name=source.name)
        half = np.maximum(half, np.abs(mesh.local_box).max(axis=0))
        described.append({"file": path.name, "triangles": len(faces), "fingerprint": mesh.fingerprint.hex()})
        proper = np.zeros(len(vertices), np.bool_)
        proper[faces[~mesh.degenerate_faces]] = True
        described[-1]["box"] = np.stack(find_bounds(mesh.local_vertices[proper])).tolist() if proper.any() else None
    index = {
        "format": FORMAT_VERSION, "name": source.name, "triangles": total, "vertices": len(source.vertices),
        "origin": origin.tolist(), "scale": scale, "half": half.tolist(), "shards": described,
    }  # fmt: skip
    (folder / INDEX_FILE).write_text(json.dumps(index | {"digest": _digest(index)}, indent=1) + "\n", encoding="utf-8")


def _share_cells(
    cells: NDArray[np.int64], counts: NDArray[np.int64], first: int, shard_count: int, firsts: NDArray[np.int32],
    shares: NDArray[np.int32],
) -> None:  # fmt: skip
    """Write the first shard of each cell, and the number of shards among which its faces are dealt: mostly one."""
    if shard_count == 1 or len(cells) == 1:
        firsts[cells], shares[cells] = first, shard_count
        return
    # Across the longest side of the cells that are left, where it divides the faces as it does the shards.
    places = cells[:, None] // _CELL_STEPS % _AXIS_CELLS
    along = places[:, np.argmax(np.ptp(places, axis=0))]
    of_planes = np.cumsum(np.bincount(along, counts[cells]))
    wanted = of_planes[-1] * (shard_count // 2 / shard_count)
    plane = int(np.argmin(np.abs(of_planes[along.min() : along.max()] - wanted)))
    # Never more shards than faces, on either side.
    share = shard_count * of_planes[along.min() + plane] / of_planes[-1]
    left = min(max(round(share), 1), shard_count - 1)
    is_left = along <= along.min() + plane
    _share_cells(cells[is_left], counts, first, left, firsts, shares)
    _share_cells(cells[~is_left], counts, first + left, shard_count - left, firsts, shares)


def _digest(index: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(index, sort_keys=True).encode()).hexdigest()


def read_shards(folder: str | os.PathLike[str]) -> tuple[Shard, ...]:
    """Return the shards of a folder that `shard_mesh` made; their files are read when they are loaded.

    Raises
    ------
    MeshError
        The folder has no ``shards.json``, or this is damaged or has another format.
    """
    path = as_path(folder) / INDEX_FILE
    with read_errors_as(MeshError, path):
        data = read_regular(path)
    try:
        index = json.loads(data)
        digest, version = index.pop("digest"), index["format"]
    except (ValueError, TypeError, AttributeError, KeyError) as error:
        raise MeshError(f"{path}: the list of the shards is damaged: cut the mesh again") from error
    if version != FORMAT_VERSION:
        raise MeshError(f"{path}: the shards have format {version!r}, and this version reads {FORMAT_VERSION}")
    if digest != _digest(index):
        raise MeshError(f"{path}: the list of the shards is damaged: cut the mesh again")
    whole = index["name"], index["triangles"], np.array(index["origin"]), index["scale"], np.array(index["half"])
    return tuple(
        Shard(
            path.parent / each["file"], each["triangles"],
            None if each["box"] is None else np.array(each["box"], np.float32), each["fingerprint"], *whole,
        )
        for each in index["shards"]
    )  # fmt: skip
