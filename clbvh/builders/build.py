"""A mesh becomes a tree: the public function, and the builders by their names.

`sah/build_sah.py` is the default builder, from where the steps can be followed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from ..bvh import Bvh
from ..errors import ConfigError, MeshError
from ..geometry import MeshLike, Shape, Spheres, as_mesh
from ..geometry.corners import Boxes
from ..geometry.joined_shapes import batch_small
from ..geometry.spheres import Bounded
from ..support.host_threads import usable_cores
from ..support.memory import check_memory
from ..support.settings import change_settings
from .executor import Executor, ThreadExecutor
from .ladder.variants import VARIANTS
from .options import DEFAULT_BUILDER, DEFAULT_QUALITY, FAST_QUALITY, HIGH_QUALITY, BuildOptions, check_workers
from .sah.build_sah import build_sah
from .sah.small_trees import build_small

if TYPE_CHECKING:
    from ..device.info import DeviceInfo
    from .processes.pool import SubtreePool


# Fewest primitives for each worker, unless a task threshold is given. A thread starts in about 100 us, and builds a
# tree over 10,000 primitives in 2 ms.
PRIMS_PER_WORKER = 10_000

# Cost of a node step in tests of a sphere, which take less time than those of a triangle. Against a cost of 1, `bvh2`
# takes 46 % less memory for 50,000 spheres, and coherent rays are 1.1 times as fast, others 1.5 times; 2 and 4 are
# nearly the same. The wide layouts, which choose their own leaves, are as fast with any (2-core x86-64 server, PoCL).
_SPHERE_TRAVERSAL_COST = 3.0

# What a build takes besides the mesh and the tree, at its peak: of a height field of 100 million triangles.
_BYTES_PER_PRIM = 100

Builder = Callable[[Bounded, Executor, BuildOptions], Bvh]

BUILDERS = (DEFAULT_BUILDER, *VARIANTS)


def find_builder(name: str, options: BuildOptions) -> Builder:
    """Return the function behind a builder's name; raise `ConfigError` as `check_builder` does."""
    check_builder(name, options)
    # A program needs one of them; the others are imported when they are asked for.
    if name in VARIANTS:
        from .ladder.build_variant import build_variant

        return partial(build_variant, VARIANTS[name])
    if options.quality == HIGH_QUALITY:
        from .reinsertion.build_high import build_high

        return build_high
    return build_sah


def check_builder(builder: str, options: BuildOptions, allowed: tuple[str, ...] = BUILDERS) -> None:
    """Raise `ConfigError` for an unknown builder, and for a quality that it does not have."""
    if builder not in allowed:
        raise ConfigError(f"builder must be one of {', '.join(allowed)}, not '{builder}'")
    if builder != DEFAULT_BUILDER and options.quality != DEFAULT_QUALITY:
        raise ConfigError(
            f"the builder {builder} has one quality, {DEFAULT_QUALITY}: leave '{options.quality}' out, or take the "
            f"builder {DEFAULT_BUILDER}"
        )


def leaf_limit(builder: str, options: BuildOptions) -> int:
    """Return the largest number of primitives in a leaf of this builder's trees."""
    return VARIANTS[builder].leaf_size(options) if builder in VARIANTS else options.leaf_size


def build(
    mesh: MeshLike,
    options: BuildOptions | None = None,
    *,
    workers: int | None = None,
    pool: SubtreePool | None = None,
    builder: str = DEFAULT_BUILDER,
    device: DeviceInfo | str | int | None = None,
    **changes: Any,
) -> Bvh:
    """Build a bounding volume hierarchy over a mesh.

    Parameters
    ----------
    mesh : Mesh, str, path, (vertices, faces), or an object of trimesh, pyvista, Open3D, meshio
        See `clbvh.MeshLike`. A path names a mesh file, see `clbvh.load_mesh`. For the quality ``"fast"`` vertices and
        faces may be a `pyopencl.array.Array`, float32 or float64, and int32, in one context: the device copies them,
        and the host downloads what it reads. Without double precision there, or on another device, they go by way of
        the host.
    options : BuildOptions, optional
        A builder ignores options that do not apply to it; a quality that it does not have is refused.
    workers : int, optional
        Threads that build, at most; the number of usable processors without it. A small mesh is built by fewer: one
        for every 10,000 triangles, unless a task threshold is given.
    pool : SubtreePool, optional
        Worker processes that build in place of threads, but not a mesh below 20,000 triangles by the default builder.
    builder : str, optional
        ``"sah"``: binned surface area heuristic on three axes, parallel from the root. Or a variant of the report's
        ladder, see `docs/ladder.md`: ``"sequential"``, which has one worker in any case, ``"naive"``, ``"range"``,
        ``"cached"``, ``"median"``, ``"bin"``, ``"atomic"``, ``"flatten"``, ``"flat"``, ``"frontier"``.
    device : DeviceInfo, str, int or None
        The device that builds a tree of the quality ``"fast"``: a number, part of its name, ``"gpu"`` or ``"host"``;
        by default a GPU, if there is one.
    **changes
        Fields of `BuildOptions` that differ from `options`: bins, leaf_size, traversal_cost, task_threshold, frontier,
        quality.

    Returns
    -------
    Bvh
        The same bytes for any workers, any threshold and any device. No leaf lies deeper than 64.

    Raises
    ------
    ConfigError
        Options of another name or type, or outside their ranges, an unknown builder, a quality that it lacks, both
        workers and a pool, or a device for a quality that the host builds.
    DeviceError
        There is no such device, or it has not enough memory.
    MeshError
        The argument does not describe a valid mesh: see `clbvh.Mesh.from_arrays` and `clbvh.load_mesh`. Or the build
        needs more memory than is free, about 100 bytes for each triangle.
    PoolError
        A worker process failed or died, or there is not enough memory to share.

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
    if not isinstance(options, BuildOptions | None):
        raise ConfigError(f"options must be a clbvh.BuildOptions, not a {type(options).__name__}")
    options = change_settings(options or BuildOptions(), changes, ConfigError)
    if options.quality == FAST_QUALITY:
        # Imported here: other trees are built where there is no OpenCL.
        from ..layouts.device_mesh import take_mesh

        return build_tree(take_mesh(mesh, device), builder, pool, options, workers, device)
    return build_tree(as_mesh(mesh), builder, pool, options, workers, device)


def build_tree(
    shape: Bounded,
    builder: str,
    pool: SubtreePool | None,
    options: BuildOptions,
    workers: int | None = None,
    device: DeviceInfo | str | int | None = None,
) -> Bvh:
    """Build a tree over any shape as `build` does over a mesh, with the options in one struct."""
    check_workers(workers)
    check_builder(builder, options)
    if device is not None and options.quality != FAST_QUALITY:
        raise ConfigError(f"only trees of quality '{FAST_QUALITY}' are built on a device: leave {device!r} out")
    if workers is not None and pool is not None:
        raise ConfigError("a build has threads of its own or the workers of a pool: leave workers or pool out")
    if options.quality == FAST_QUALITY:
        from .device.build_device import build_fast

        return build_fast(shape, options, device)
    run = find_builder(builder, options)
    subject = f"{shape.name}: a tree over {shape.prim_count:,} primitives"
    check_memory(subject, shape.prim_count * _BYTES_PER_PRIM, MeshError)
    if builder in VARIANTS:
        uses_pool = VARIANTS[builder].parallel
    else:
        uses_pool = options.task_threshold is not None or shape.prim_count >= 2 * PRIMS_PER_WORKER
    if pool is not None and uses_pool:
        from .processes.pool import open_executor

        with open_executor(pool) as executor:
            return run(shape, executor, options)
    with ThreadExecutor(choose_workers(shape.prim_count, builder, options, workers)) as executor:
        return run(shape, executor, options)


def choose_workers(prim_count: int, builder: str, options: BuildOptions, workers: int | None) -> int:
    """Return the number of threads that build a tree without a pool."""
    if builder in VARIANTS and not VARIANTS[builder].parallel:
        return 1
    most = int(workers or usable_cores())
    return most if options.task_threshold is not None else max(1, min(most, prim_count // PRIMS_PER_WORKER))


def build_shape(shape: Bounded, quality: str, device: DeviceInfo | None = None) -> Bvh:
    """Build a tree over a shape as `build` does, if need be on a device; over spheres with leaves that suit them."""
    on = device if quality == FAST_QUALITY else None
    return build_tree(shape, DEFAULT_BUILDER, None, suit_options(shape, quality), device=on)


def plan_tree(shape: Shape, quality: str) -> Bvh | BuildOptions:
    """Return the tree over a shape as `build_shape` builds it; the options of one that a device is to build."""
    return suit_options(shape, quality) if quality == FAST_QUALITY else build_shape(shape, quality)


def plan_trees(shapes: Sequence[Shape], quality: str) -> Sequence[Bvh | BuildOptions]:
    """Return what `plan_tree` does of each shape."""
    if quality == FAST_QUALITY:
        return [suit_options(shape, quality) for shape in shapes]
    return build_shapes(shapes, quality)


def build_shapes(shapes: Sequence[Shape], quality: str) -> list[Bvh]:
    """Build a tree over each shape as `build_shape` does on the host; many small ones take less time together."""
    small = build_small_shapes(shapes, DEFAULT_BUILDER, partial(suit_options, quality=quality))
    return [small.get(number) or build_shape(shape, quality) for number, shape in enumerate(shapes)]


def build_small_shapes(
    shapes: Sequence[Shape],
    builder: str,
    find_options: Callable[[Shape], BuildOptions],
    workers: int | None = None,
) -> dict[int, Bvh]:
    """Return the trees of those shapes that are small, by their numbers, as `build_tree` builds them one by one.

    None is where the builder or the quality is another than the default one, or where they are few.
    """
    trees: dict[int, Bvh] = {}
    for batch in batch_small(shapes):
        own = [shapes[number] for number in batch]
        options = find_options(own[0])
        if builder == DEFAULT_BUILDER and options.quality == DEFAULT_QUALITY:
            trees |= zip(batch, build_small(own, options, workers), strict=True)
    return trees


def suit_options(shape: Bounded, quality: str) -> BuildOptions:
    """Return the options that suit the primitives of a shape, with the quality that is wanted."""
    cost = _SPHERE_TRAVERSAL_COST if isinstance(shape, Spheres) else BuildOptions.traversal_cost
    return BuildOptions(traversal_cost=cost, quality=quality)


def build_top(boxes: Boxes) -> Bvh:
    """Build the tree over the boxes of instances, one in each leaf."""
    return build_tree(boxes, DEFAULT_BUILDER, None, BuildOptions(leaf_size=1))
