"""The refinement of a block of hits, on a mesh or on the placed geometries of a scene.

Compiled functions call `refine_block` and `locate`; numba chooses the functions by the type of the surface.
"""

from __future__ import annotations

from numba.extending import overload

from .refine_block import gather_triangles, intersect_planes, locate_on_triangles, settle
from .refine_placed import finish_placed, gather_placed, locate_placed
from .scene_arrays import SceneArrays


def refine_block(rays, surface, found_ints, block, count):
    """Write t, u, v and the side of a block's hits into the block."""
    raise NotImplementedError("for compiled functions")


def locate(surface, found_ints, block, count, locations):
    """Write the points of a block's hits to their targets, in the coordinates of the file or the scene."""
    raise NotImplementedError("for compiled functions")


@overload(refine_block)
def _choose_refinement(rays, surface, found_ints, block, count):
    def on_mesh(rays, surface, found_ints, block, count):
        gather_triangles(rays, surface, found_ints, block, count)
        intersect_planes(block.vectors, block.volumes, count)
        settle(block, count)

    def in_scene(rays, surface, found_ints, block, count):
        gather_placed(rays, surface, found_ints, block, count)
        intersect_planes(block.vectors, block.volumes, count)
        settle(block, count)
        finish_placed(rays, surface, found_ints, block, count)

    return in_scene if surface.instance_class is SceneArrays else on_mesh


@overload(locate)
def _choose_location(surface, found_ints, block, count, locations):
    def on_mesh(surface, found_ints, block, count, locations):
        locate_on_triangles(surface, found_ints, block, count, locations)

    def in_scene(surface, found_ints, block, count, locations):
        locate_placed(surface, found_ints, block, count, locations)

    return in_scene if surface.instance_class is SceneArrays else on_mesh
