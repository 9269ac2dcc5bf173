"""Casting rays at a mesh with the shipped kernels, in any layout."""

from contextlib import contextmanager
from functools import cache

import numpy as np

from clbvh.device.program import build_kernel
from clbvh.layout import HIT
from clbvh.trace.device_tree import DeviceTree
from clbvh.trace.tracer import pack_rays

GROUP_SIZE = 64
RESULT_TYPES = {"closest_hit": HIT, "any_hit": np.dtype(np.uint8)}


@cache
def compiled(session, name, defines):
    """The kernel, built once for all tests that cast with the same macros."""
    return build_kernel(session, name, dict(defines))


@contextmanager
def open_caster(session, mesh, bvh):
    """Give a function from a kernel's name and rays to its results; `bvh` None for no tree."""
    tree = DeviceTree(session, mesh, bvh)
    kernels = {name: compiled(session, name, tuple(tree.defines.items())) for name in RESULT_TYPES}

    def cast(name, origins, directions, t_min=0.0, t_max=np.inf):
        rays, exponents = pack_rays(origins, directions, t_min, t_max, mesh.origin)
        assert exponents is None
        results = np.zeros(len(rays), RESULT_TYPES[name])
        given, written = session.upload(rays), session.upload(results)
        try:
            session.run(
                kernels[name], (len(rays),), (GROUP_SIZE,), *tree.arguments, given, written, np.int32(len(rays))
            )
            session.download(written, results)
        finally:
            session.release(given)
            session.release(written)
        return results

    try:
        yield cast
    finally:
        for buffer in tree.arguments[:2]:
            session.release(buffer)
