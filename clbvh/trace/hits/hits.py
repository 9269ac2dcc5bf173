"""The results of ray queries."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ...geometry import Mesh
from ...structs import NO_PRIM
from .locations import find_locations, find_normals


@dataclass(frozen=True, eq=False)
class Hits:
    """One crossing per ray, at ``(1 - u - v) a + u b + v c`` of the triangle with the corners a, b and c.

    Attributes
    ----------
    t : (...,) float64, or float32 in a picture, lengths of the ray's direction
        Distance from the ray's origin; infinite on a miss.
    u, v : (...,) of the same dtype
        Barycentric coordinates; 0 on a miss.
    prim_id : (...,) int32
        Face of the mesh; -1 on a miss.
    mesh : Mesh or None
        What was hit.

    Examples
    --------
    >>> import clbvh
    >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    >>> with clbvh.Tracer(mesh) as tracer:
    ...     hits = tracer.closest_hit([[1, 2, 5], [3, 3, 5]], [[0, 0, -1], [0, 0, -1]])
    >>> hits.is_hit, hits.t, hits.prim_id
    (array([ True, False]), array([ 5., inf]), array([ 0, -1], dtype=int32))
    >>> hits.u, hits.v
    (array([0.25, 0.  ]), array([0.5, 0. ]))
    >>> hits.locations
    array([[ 1.,  2.,  0.],
           [nan, nan, nan]])
    >>> hits.normals
    array([[ 0.,  0.,  1.],
           [nan, nan, nan]])
    """

    t: NDArray[np.floating]
    u: NDArray[np.floating]
    v: NDArray[np.floating]
    prim_id: NDArray[np.int32]
    mesh: Mesh | None = field(default=None, repr=False)

    @classmethod
    def from_device(cls, hits: NDArray[np.void], mesh: Mesh | None = None) -> Hits:
        """Take an array of `structs.HIT` apart; the fields are views of it.

        Examples
        --------
        >>> import clbvh
        >>> import numpy as np
        >>> from clbvh.structs import HIT
        >>> clbvh.Hits.from_device(np.zeros(3, HIT)).prim_id
        array([0, 0, 0], dtype=int32)
        """
        return cls(hits["t"], hits["u"], hits["v"], hits["prim_id"], mesh)

    @property
    def is_hit(self) -> NDArray[np.bool_]:
        """(...,) bool: whether the ray hits anything."""
        return self.prim_id != NO_PRIM

    @property
    def count(self) -> int:
        """Number of rays that hit something."""
        return int(np.count_nonzero(self.is_hit))

    @property
    def locations(self) -> NDArray[np.float64]:
        """(..., 3) float64, the file's coordinates: where the triangle is hit; NaN on a miss."""
        return find_locations(self._known_mesh(), self.prim_id, self.u, self.v)

    @property
    def normals(self) -> NDArray[np.float64]:
        """(..., 3) float64: the triangle's normal of length 1, on the side from which a, b, c run anticlockwise.

        NaN on a miss. The ray may come from either side.
        """
        return find_normals(self._known_mesh(), self.prim_id)

    def take(self, rays: NDArray[np.int64]) -> Hits:
        """Return the hits of some rays, by their numbers in C order.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> with clbvh.Tracer(trimesh.creation.box()) as tracer:
        ...     hits = tracer.closest_hit([[3, 0, 5], [0.1, 0.2, 5]], [[0, 0, -1], [0, 0, -1]])
        >>> hits.take(hits.is_hit.nonzero()[0]).t
        array([4.5])
        """
        t, u, v = (field.reshape(-1)[rays] for field in (self.t, self.u, self.v))
        return Hits(t, u, v, self.prim_id.reshape(-1)[rays], self.mesh)

    def __len__(self) -> int:
        return len(self.prim_id)

    def _known_mesh(self) -> Mesh:
        if self.mesh is None:
            raise ConfigError("these hits do not know their mesh: make them with Hits(..., mesh=...)")
        return self.mesh


@dataclass(frozen=True, eq=False)
class AllHits(Hits):
    """Every crossing of every ray, ray after ray, each ray's in the order along it.

    The fields of `Hits` have one entry per crossing; none is a miss.

    Attributes
    ----------
    offsets : (n + 1,) int64
        The crossings of ray i are those from ``offsets[i]`` to ``offsets[i + 1]``.
    known_locations : (m, 3) float64 or None
        What `locations` returns, where it was found along with the hits.

    Examples
    --------
    >>> import clbvh
    >>> import trimesh
    >>> with clbvh.Tracer(trimesh.creation.box()) as tracer:
    ...     hits = tracer.all_hits([[0.1, 0.2, 5], [3, 0, 5], [0.3, 0, 0]], [[0, 0, -1], [0, 0, -1], [1, 0, 0]])
    >>> hits.t, hits.ray_id
    (array([4.5, 5.5, 0.2]), array([0, 0, 2]))
    >>> hits.counts, hits.offsets
    (array([2, 0, 1]), array([0, 2, 2, 3]))
    >>> hits.t[hits.offsets[0] : hits.offsets[1]]  # of ray 0
    array([4.5, 5.5])
    """

    offsets: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64), kw_only=True)

    known_locations: NDArray[np.float64] | None = field(default=None, repr=False, kw_only=True)

    @property
    def locations(self) -> NDArray[np.float64]:
        """(m, 3) float64, the file's coordinates: where the triangles are crossed."""
        return super().locations if self.known_locations is None else self.known_locations

    @property
    def counts(self) -> NDArray[np.int64]:
        """(n,) int64: crossings of each ray."""
        return np.diff(self.offsets)

    @property
    def ray_id(self) -> NDArray[np.int64]:
        """(m,) int64: the ray of each crossing."""
        return np.repeat(np.arange(len(self.offsets) - 1), self.counts)
