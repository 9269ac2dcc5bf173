"""A finished tree: nodes, the order of the primitives, the shape they index; its depth and its expected cost.

It must not know how it was built, nor who traverses it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..device.host.loops import Loops
from ..geometry import Mesh, Shape
from ..geometry.spheres import Bounded
from ..support.stopwatch import Stopwatch
from .refit import fit_nodes
from .serialize import read_tree, write_tree

_LOOPS = Loops("bvh/nodes")


def find_depths(nodes: NDArray[np.void]) -> NDArray[np.int32]:
    """Return the number of edges from the root to each node, (N,) int32; children stand behind their parent."""
    depths = np.zeros(len(nodes), np.int32)
    _LOOPS.find_depths(np.ascontiguousarray(nodes), depths)
    return depths


@dataclass(frozen=True, eq=False)
class Bvh:
    """A flat bounding volume hierarchy in depth-first order.

    Attributes
    ----------
    nodes : (N,) `structs.NODE`
        Boxes in the shape's local coordinates. Node 0 is the root. Siblings are neighbours, and the left child's
        subtree comes before the right one's. All nodes are used.
    prim_ids : (F,) int32
        A permutation of the mesh's faces: leaf `nodes[i]` holds
        ``prim_ids[first : first + count]``.
    shape : Mesh
        The indexed shape; in the trees of a scene also spheres, or the boxes of its instances.
    mesh : Mesh
        The shape, of trees over meshes.
    timings_ms : mapping of str to float
        Wall time of each phase of the build, or of `refit` or `load`, in milliseconds.

    Examples
    --------
    >>> import clbvh
    >>> bvh = clbvh.build(clbvh.make_shape("icosphere", triangles=1000))
    >>> int(bvh.nodes["count"].sum()), len(bvh.prim_ids)  # each face in one leaf
    (980, 980)
    """

    nodes: NDArray[np.void]
    prim_ids: NDArray[np.int32]
    shape: Bounded
    timings_ms: Mapping[str, float] = field(default_factory=dict)

    @property
    def mesh(self) -> Mesh:
        """The mesh that `prim_ids` refers to, in the trees of `clbvh.build`."""
        return cast(Mesh, self.shape)

    @property
    def node_count(self) -> int:
        """Number of nodes, leaves included."""
        return len(self.nodes)

    @cached_property
    def depth(self) -> int:
        """Number of edges from the root to the deepest leaf; 0 for a tree that is one leaf."""
        return int(find_depths(self.nodes).max())

    def refit(self, vertices: ArrayLike) -> Bvh:
        """Return a tree of the same topology around vertices that have moved.

        For deforming meshes: an order of magnitude faster than a build. Every ray finds the same hit as with a new
        build, but takes longer the further the triangles have moved apart.

        Parameters
        ----------
        vertices : (V, 3) float, the file's coordinates
            The same number as before; not modified.

        Returns
        -------
        Bvh
            A new tree, over a new mesh with its own origin and scale. It shares `prim_ids` and the faces of the mesh.

        Raises
        ------
        MeshError
            Another number of vertices, wrong shape or dtype, or a coordinate that is NaN or infinite.

        Examples
        --------
        >>> import numpy as np
        >>> from clbvh import Mesh, build
        >>> bvh = build(Mesh.from_arrays(np.eye(3), [[0, 1, 2]]))
        >>> bvh.refit(np.diag([2, 4, 4])).nodes["aabb_max"].tolist()
        [[0.25, 0.5, 0.5]]
        """
        watch = Stopwatch()
        mesh = self.mesh.with_vertices(vertices)
        watch.lap("localize")
        nodes = fit_nodes(self.nodes["first"], self.nodes["count"], self.prim_ids, mesh)
        watch.lap("refit")
        return Bvh(nodes, self.prim_ids, mesh, watch.laps_ms)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the tree into one file, without its mesh.

        Parameters
        ----------
        path : str or path
            A file of this name is replaced once the new one is complete.

        Raises
        ------
        ConfigError
            The folder does not exist, or the path is a folder.
        OSError
            The file cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> import clbvh
        >>> from pathlib import Path
        >>> bvh = clbvh.build(clbvh.make_shape("icosphere", triangles=1000))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     bvh.save(Path(folder, "sphere.tree"))
        ...     again = clbvh.Bvh.load(Path(folder, "sphere.tree"), bvh.mesh)
        >>> again.nodes.tobytes() == bvh.nodes.tobytes()
        True
        """
        write_tree(path, self.nodes, self.prim_ids, cast(Shape, self.shape))

    @classmethod
    def load(cls, path: str | os.PathLike[str], mesh: Shape) -> Bvh:
        """Read a tree that was saved.

        Parameters
        ----------
        path : str or path
        mesh : Mesh
            The mesh that the tree was built over: the same faces and local vertices, whatever its name, unit and place.

        Returns
        -------
        Bvh
            The same bytes that were saved, if a builder of clbvh made them.

        Raises
        ------
        TreeFileError
            The file is missing, is not a saved tree, has another format, belongs to another mesh, or is damaged. The
            content is not trusted: a tree that is returned is valid, whatever the file holds.

        Examples
        --------
        >>> import tempfile
        >>> import clbvh
        >>> from pathlib import Path
        >>> sphere = clbvh.make_shape("icosphere", triangles=1000)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder, "sphere.tree")
        ...     clbvh.build(sphere).save(path)
        ...     bvh = clbvh.Bvh.load(path, sphere)
        >>> bvh.mesh is sphere
        True
        """
        watch = Stopwatch()
        nodes, prim_ids = read_tree(path, mesh)
        watch.lap("load")
        return cls(nodes, prim_ids, mesh, watch.laps_ms)

    def __repr__(self) -> str:
        return f"Bvh({self.shape.name!r}, nodes={self.node_count:,}, depth={self.depth})"


def sah_cost(bvh: Bvh, *, traversal_cost: float = 1.0, intersection_cost: float = 1.0) -> float:
    """Return the expected cost of a random ray that hits the root's box, by the surface area heuristic.

    Parameters
    ----------
    bvh : Bvh
    traversal_cost : float
        Cost of an interior node.
    intersection_cost : float
        Cost of one triangle test.

    Returns
    -------
    float
        The sum over all nodes of cost times area, relative to the root's area (MacDonald and Booth, "Heuristics
        for ray tracing using space subdivision", 1990). For a mesh without extent, whose areas are all zero, the
        cost of the ray that visits everything.

    Examples
    --------
    A tree that was refitted costs the more, the farther its triangles have moved apart. Build again above 1.3 times:

    >>> import clbvh
    >>> import numpy as np
    >>> boxes = clbvh.make_shape("boxes", triangles=1200)
    >>> shift = np.random.default_rng(0).normal(size=(100, 3))
    >>> bvh = clbvh.build(boxes).refit(boxes.vertices + shift.repeat(8, axis=0))  # 8 corners of each box
    >>> clbvh.sah_cost(bvh) > 1.3 * clbvh.sah_cost(clbvh.build(bvh.mesh))
    True
    """
    nodes = bvh.nodes
    size = nodes["aabb_max"].astype(np.float64) - nodes["aabb_min"]
    areas = size[:, 0] * size[:, 1] + size[:, 1] * size[:, 2] + size[:, 2] * size[:, 0]
    costs = np.where(nodes["count"] > 0, nodes["count"] * intersection_cost, traversal_cost)
    if areas[0] == 0:
        return float(costs.sum())
    return float((areas * costs).sum() / areas[0])
