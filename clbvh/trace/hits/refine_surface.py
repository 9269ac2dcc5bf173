"""The refinement of a block of hits, on a mesh or on the placed geometries of a scene.

Compiled functions call `refine_block` and `locate`; numba chooses the functions by the type of the surface.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba.extending import overload

from .refine_block import gather_triangles, intersect_planes, locate_on_triangles, settle
from .refine_placed import finish_placed, gather_placed, locate_placed
from .scene_arrays import SceneArrays


def refine_block(rays: Any, surface: Any, found_ints: Any, block: Any, count: Any) -> None:
    """Write t, u, v and the side of a block's hits into the block."""
    raise NotImplementedError("for compiled functions")


def locate(surface: Any, found_ints: Any, block: Any, count: Any, locations: Any) -> None:
    """Write the points of a block's hits to their targets, in the coordinates of the file or the scene."""
    raise NotImplementedError("for compiled functions")


@overload(refine_block)
def _choose_refinement(rays: Any, surface: Any, found_ints: Any, block: Any, count: Any) -> Callable[..., None]:
    def on_mesh(rays: Any, surface: Any, found_ints: Any, block: Any, count: Any) -> None:
        gather_triangles(rays, surface, found_ints, block, count)
        intersect_planes(block.vectors, block.volumes, count)
        settle(block, count)

    def in_scene(rays: Any, surface: Any, found_ints: Any, block: Any, count: Any) -> None:
        if len(surface.faces) > 0:
            gather_placed(rays, surface, found_ints, block, count)
            intersect_planes(block.vectors, block.volumes, count)
            settle(block, count)
        finish_placed(rays, surface, found_ints, block, count)

    return in_scene if surface.instance_class is SceneArrays else on_mesh


@overload(locate)
def _choose_location(surface: Any, found_ints: Any, block: Any, count: Any, locations: Any) -> Callable[..., None]:
    def on_mesh(surface: Any, found_ints: Any, block: Any, count: Any, locations: Any) -> None:
        locate_on_triangles(surface, found_ints, block, count, locations)

    def in_scene(surface: Any, found_ints: Any, block: Any, count: Any, locations: Any) -> None:
        locate_placed(surface, found_ints, block, count, locations)

    return in_scene if surface.instance_class is SceneArrays else on_mesh
