"""Worlds on a device, of one mesh whose tree and layout are given; and the arrays of layouts."""

from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from clbvh import Scene
from clbvh.layouts.device_arrays import make_device_arrays
from clbvh.support.host_threads import HostThreads
from clbvh.trace.world.world import open_world


class Arrays(NamedTuple):
    nodes: np.ndarray
    blocks: np.ndarray
    stack_size: int


def arrays_of(bvh, layout):
    """The arrays that the host makes."""
    made = make_device_arrays(bvh, layout)
    blocks = np.full(made.byte_count - made.nodes.nbytes, 0xAA, np.uint8).view(made.blocks.struct)
    with HostThreads() as threads:
        made.blocks.write(blocks, threads)
    return Arrays(made.nodes, blocks, made.stack_size)


def open_mesh(session, mesh, bvh=None, layout="auto"):
    """The `World` of a mesh and its tree; without a tree, that of the layout ``"brute"``."""
    return open_world(session, Scene(mesh).snapshot(), None if bvh is None else [bvh], layout)


def release(session, world):
    """Give the device's memory of a world back, before the session is closed."""
    for buffer in world.trees.buffers.values():
        session.release(buffer)


@contextmanager
def mesh_on_device(session, mesh, bvh=None, layout="auto"):
    """Give the `World` of a mesh for as long as the block lasts."""
    world = open_mesh(session, mesh, bvh, layout)
    try:
        yield world
    finally:
        release(session, world)
