"""Casting rays at a mesh with the shipped kernels, in any layout."""

from contextlib import contextmanager

import numpy as np

from clbvh.structs import HIT, NO_PRIM
from clbvh.trace.world.starts import TILE_KERNEL, find_entry_points
from clbvh.tree_layouts import LAYOUTS, WIDE_LAYOUTS

from ..worlds import mesh_on_device
from .programs import build_text, make_rays

FLAT_TILE = (64, 1)

# The kernels that cast rays, in one program: a test compiles all of them at once.
KERNELS = ("any_hit", "closest_hit", "count_hits", "first_hits")

NO_LIMIT = np.iinfo(np.int32).max

# The results of each kernel: the argument's name and the dtype of one result.
RESULTS = {
    "closest_hit": ("hits", HIT),
    "any_hit": ("blocked", np.dtype(np.uint8)),
    "count_hits": ("counts", np.dtype(np.int32)),
    "first_hits": ("hits", HIT),
}

# One stack size for all trees, so that they share a program: the one that the deepest trees, the chains, need and fill.
STACK_SIZE = 48


@contextmanager
def open_caster(session, mesh, bvh=None, layout="auto", *, row_length=None, tile=FLAT_TILE, with_entry_points=False):
    """Give a `Caster` for a mesh and its tree; `bvh` None for no tree.

    `row_length` is the number of rays in a row, all of them without it.
    """
    with mesh_on_device(session, mesh, bvh, layout) as world:
        yield Caster(session, mesh, world, row_length, tile, with_entry_points)


class Caster:
    """A function from a query and rays to its results; see `open_caster`."""

    def __init__(self, session, mesh, world, row_length, tile, with_entry_points):
        self._session, self._mesh, self._world = session, mesh, world
        self._row_length, self._tile, self._with_entry_points = row_length, tile, with_entry_points

    def __call__(self, query, origins, directions, t_min=0.0, t_max=np.inf, max_hits=NO_LIMIT):
        """The results of a kernel; or of ``all_hits`` the hits, and the (n + 1,) offsets of each ray's."""
        rays = self._make_rays(origins, directions, t_min, t_max)
        if query == "all_hits":
            return self._find_all_hits(rays, max_hits)
        return self._run(query, rays, **({"max_hits": max_hits} if query == "count_hits" else {}))

    def find_entry_points(self, origins, directions):
        """The entry points of all tiles, as nodes."""
        with self._on_device(self._make_rays(origins, directions)) as (rays, work_size):
            starts = self._find_starts(rays, work_size)
            tile_count = np.prod([-(-length // edge) for length, edge in zip(work_size, self._tile, strict=True)])
            found = np.zeros(tile_count, LAYOUTS[self._world.layout].node)
            self._session.download(starts["entry_points"], found)
            self._session.release(starts["entry_points"])
        return found

    def _make_rays(self, origins, directions, *limits):
        """Rays in local coordinates; with scaled directions, their t stays the same."""
        return make_rays(self._mesh.to_local(origins), np.multiply(directions, self._mesh.scale), *limits)

    def _find_all_hits(self, rays, max_hits):
        counts = self._run("count_hits", rays, max_hits=max_hits)
        slots = max(1, int(counts.max(initial=0)))
        hits = self._run("first_hits", rays, results_per_ray=slots, slots=slots).reshape(-1, slots)
        has_room = counts < slots
        # A miss follows the last hit.
        assert (hits["prim_id"][has_room, counts[has_room]] == NO_PRIM).all()
        return hits[np.arange(slots) < counts[:, None]], np.concatenate(([0], np.cumsum(counts)))

    def _run(self, name, packed, results_per_ray=1, **more):
        argument, dtype = RESULTS[name]
        numbers = {key: np.int32(value) for key, value in more.items()}
        results = np.zeros(results_per_ray * len(packed), dtype)
        with self._on_device(packed) as (rays, work_size):
            buffer = self._session.upload(results)
            starts = {"entry_points": None, "tiles": None, "side": np.int32(0), "excluded": None}
            if self._with_entry_points and self._world.has_entry_points:
                starts |= self._find_starts(rays, work_size)
            self._session.run(
                self._kernel(name), work_size, self._tile, **self._world.arguments, **rays, order=None, **starts,
                **{argument: buffer}, **numbers,
            )  # fmt: skip
            self._session.download(buffer, results)
            for held in (buffer, starts["entry_points"]):
                if held is not None:
                    self._session.release(held)
        return results

    @contextmanager
    def _on_device(self, packed):
        """Give the arguments that describe rays, and the size of the launch."""
        row_length = self._row_length or len(packed)
        rays = self._session.upload(packed)
        try:
            counts = {"ray_count": np.int32(len(packed)), "row_length": np.int32(row_length)}
            described = {"rays": rays, "lows": None, "low_step": np.int32(0), **counts}
            yield described, (row_length, -(-len(packed) // row_length))
        finally:
            self._session.release(rays)

    def _find_starts(self, rays, work_size):
        """The arguments that say where the rays of each tile begin."""
        kernel = self._kernel(TILE_KERNEL)
        return find_entry_points(
            self._session, self._world, kernel, lambda _, size: self._session.allocate(size), work_size, self._tile,
            **rays,
        )  # fmt: skip

    def _kernel(self, name):
        stack_size = max(STACK_SIZE, self._world.defines["STACK_SIZE"])
        defines = self._world.defines | {"STACK_SIZE": stack_size}
        names = (*KERNELS, TILE_KERNEL) if self._world.layout in WIDE_LAYOUTS else KERNELS
        source = "\n".join(f'#include "kernels/{name}.cl"' for name in names)
        return build_text(self._session, source, tuple(sorted(defines.items())))[name]
