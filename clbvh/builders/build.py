"""A mesh becomes a tree: the public function.

`registry` finds the builder by its name: `sah/build_sah.py` for the default, from where the steps can be followed.
"""

from __future__ import annotations

from ..bvh import Bvh
from ..geometry import Mesh, MeshLike, Shape, Spheres, as_mesh
from ..geometry.box_mesh import mesh_of
from .options import BuildOptions
from .registry import DEFAULT_BUILDER, find_builder
from .subtree_pool import SubtreePool

# Cost of a node step in tests of a sphere, which take less time than those of a triangle. Against a cost of 1, `bvh2`
# takes 46 % less memory for 50,000 spheres, and coherent rays are 1.1 times as fast, others 1.5 times; 2 and 4 are
# nearly the same. The wide layouts, which choose their own leaves, are as fast with any (2-core x86-64 server, PoCL).
_SPHERE_TRAVERSAL_COST = 3.0


def build(
    mesh: MeshLike,
    *,
    pool: SubtreePool | None = None,
    builder: str = DEFAULT_BUILDER,
    bins: int | None = BuildOptions.bins,
    leaf_size: int = BuildOptions.leaf_size,
    traversal_cost: float = BuildOptions.traversal_cost,
    task_threshold: int | None = BuildOptions.task_threshold,
    frontier: int = BuildOptions.frontier,
    quality: str = BuildOptions.quality,
) -> Bvh:
    """Build a bounding volume hierarchy over a mesh.

    Parameters
    ----------
    mesh : Mesh, trimesh.Trimesh, str, path or (vertices, faces)
        A path names a mesh file, see `clbvh.load_mesh`.
    pool : SubtreePool, optional
        Worker processes that share the work. Without one the calling process builds, as the default builder does for
        small meshes in any case.
    builder : str, optional
        ``"sah"``: binned surface area heuristic on three axes, parallel from the root. Or a variant of the report's
        ladder, see `docs/ladder.md`: ``"sequential"``, ``"naive"``, ``"range"``, ``"cached"``, ``"median"``,
        ``"bin"``, ``"atomic"``, ``"flatten"``, ``"flat"``, ``"frontier"``.
    bins, leaf_size, traversal_cost, task_threshold, frontier, quality : optional
        See `clbvh.BuildOptions`. A builder ignores options that do not apply to it; a quality that it does not have
        is refused.

    Returns
    -------
    Bvh
        The same bytes for any pool and any threshold. No leaf lies deeper than 64.

    Raises
    ------
    ConfigError
        An option outside its range, an unknown builder, or a quality that it does not have.
    MeshError
        The argument does not describe a valid mesh: see `clbvh.Mesh.from_arrays` and `clbvh.load_mesh`.
    PoolError
        A worker failed or died, or there is not enough memory to share.

    Examples
    --------
    >>> import clbvh
    >>> mesh = clbvh.make_shape("icosphere", triangles=1000)
    >>> bvh = clbvh.build(mesh)
    >>> len(bvh.prim_ids)
    980
    >>> fast = clbvh.build(mesh, quality="fast")
    >>> clbvh.sah_cost(fast) > clbvh.sah_cost(bvh)
    True
    """
    options = BuildOptions(bins, leaf_size, traversal_cost, task_threshold, frontier, quality)
    return build_tree(as_mesh(mesh), builder, pool, options)


def build_tree(mesh: Mesh, builder: str, pool: SubtreePool | None, options: BuildOptions) -> Bvh:
    """Build a tree as `build` does, with the options in one struct."""
    return find_builder(builder, options)(mesh, pool, options)


def build_over(shape: Shape, builder: str, pool: SubtreePool | None, options: BuildOptions) -> Bvh:
    """Build a tree over a shape with any builder.

    Parameters
    ----------
    shape : Mesh or Spheres
    builder, pool, options
        As of `build`.

    Returns
    -------
    Bvh
        Its mesh is the shape, or, of spheres, the mesh of their boxes: `prim_ids` are the indices of the spheres, and
        origin and scale are theirs.
    """
    return build_tree(mesh_of(shape), builder, pool, options)


def build_shape(shape: Shape) -> Bvh:
    """Build a tree over a shape in this process, as `build` does; over spheres with leaves that suit them."""
    options = BuildOptions(traversal_cost=_SPHERE_TRAVERSAL_COST) if isinstance(shape, Spheres) else BuildOptions()
    return build_over(shape, DEFAULT_BUILDER, None, options)
