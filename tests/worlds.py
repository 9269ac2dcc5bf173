"""Worlds on a device, of one mesh whose tree and layout are given."""

from contextlib import contextmanager

from clbvh import Scene
from clbvh.trace.world.world import open_world


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
