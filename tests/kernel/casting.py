"""Casting rays at a mesh with the shipped kernels, in any layout."""

from contextlib import contextmanager
from functools import cache

import numpy as np

from clbvh.device.program import build_kernel
from clbvh.layout import HIT, RAY
from clbvh.trace.device_tree import DeviceTree
from clbvh.trace.entries import open_tile_entries
from clbvh.trace.rays import RayBox, pack_rays, read_rays

FLAT_TILE = (64, 1)
RESULT_TYPES = {"closest_hit": HIT, "any_hit": np.dtype(np.uint8), "count_hits": np.dtype(np.int32), "all_hits": HIT}
NO_LIMIT = np.iinfo(np.int32).max


@cache
def compiled(session, name, defines):
    """The kernel, built once for all tests that cast with the same macros."""
    return build_kernel(session, name, dict(defines))


@contextmanager
def open_caster(session, mesh, bvh, layout="auto", *, width=None, tile=FLAT_TILE, with_entries=False):
    """Give a function from a kernel's name and rays to its results; `bvh` None for no tree.

    Of all_hits these are the hits and the (n + 1,) offsets of each ray's. `width` is the number of rays in a row, all
    of them without it.
    """
    tree = DeviceTree(session, mesh, bvh, layout)
    kernels = {name: compiled(session, name, tuple(tree.defines.items())) for name in RESULT_TYPES}

    entries = open_tile_entries(session, tree)
    box = RayBox(mesh.origin, np.full(3, 2.0**100))  # nothing is outside: the device casts what is given

    def run(name, rays, results, *more):
        given, written = session.upload(rays), session.upload(results)
        try:
            columns = width or len(rays)
            size = columns, -(-len(rays) // columns)
            counts = np.int32(len(rays)), np.int32(columns)
            begins = entries.find(size, tile, given, *counts) if with_entries else None
            session.run(kernels[name], size, tile, *tree.arguments, given, written, *counts, None, begins, *more)
            session.download(written, results)
        finally:
            session.release(given)
            session.release(written)
        return results

    def cast(name, origins, directions, t_min=0.0, t_max=np.inf, max_hits=NO_LIMIT):
        batch = read_rays(origins, directions, t_min, t_max)
        rays = np.empty(len(batch), RAY)
        pack_rays(batch.part(0, len(batch)), box, rays)
        if name not in ("count_hits", "all_hits"):
            return run(name, rays, np.zeros(len(rays), RESULT_TYPES[name]))
        counts = run("count_hits", rays, np.zeros(len(rays), np.int32), np.int32(max_hits))
        if name == "count_hits":
            return counts
        offsets = np.zeros(len(rays) + 1, np.int32)
        np.cumsum(counts, out=offsets[1:])
        uploaded = session.upload(offsets)
        try:
            return run(name, rays, np.zeros(offsets[-1], HIT), uploaded), offsets
        finally:
            session.release(uploaded)

    try:
        yield cast
    finally:
        entries.release()
        for buffer in tree.arguments[:2]:
            session.release(buffer)
