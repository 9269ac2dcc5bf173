"""What a device needs to decide in float64 what rays hit, for worlds that span scales; see cl/exact/ray.cl.

Such a world has a shape that does, or instances that are as small beside it: then float32 orders their hits no better
than it resolves the largest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...device.session import DeviceSession
from ...geometry import Shape
from ...geometry.scales import LEAST_SHARE
from ...structs import EXACT_INSTANCE
from ...support.say_once import say_once
from .refine_buffers import RefineBuffers
from .surface_arrays import SurfaceArrays
from .top_tree import TopTree

# Sixteen roundings of float64: of both maps, of the inverse, and of the differences before.
_MAP_ROUNDING = 2.0**-49

NOT_EXACT: dict[str, Any] = dict.fromkeys(("exact_instances", "exact_vertices", "exact_faces", "exact_solids"))
"""The arguments of kernels that decide in float32."""


def put_exact_arrays(
    owner: DeviceSession, session: DeviceSession, arrays: SurfaceArrays, top: TopTree | None, refine: RefineBuffers
) -> dict[str, Any]:
    """Return the arguments of kernels that decide in float64, or `NOT_EXACT` where the device cannot.

    Parameters
    ----------
    owner : DeviceSession
        Of the buffers.
    session : DeviceSession
        The owner, or a branch of it for this thread.
    arrays : SurfaceArrays
    top : TopTree or None
        None of a lone shape.
    refine : RefineBuffers
        Has the vertices and the faces.
    """
    if not session.info.has_fp64:
        say_once(
            f"the device '{session.info.name}' has no double precision: rays may miss what is smaller than 2^-16 of "
            'the whole; the CPU has it, device="cpu"'
        )
        return NOT_EXACT
    refined = refine.on(owner, session)
    buffers = {"exact_vertices": refined["vertices"], "exact_faces": refined["faces"], "exact_solids": None}
    for name, array in (("exact_instances", make_exact_instances(arrays, top)), ("exact_solids", arrays.solids)):
        if len(array):
            buffers[name] = owner.allocate(array.nbytes, writable=False)
            session.write(buffers[name], array)
    return buffers


def spans_scales(shapes: Sequence[Shape], top: TopTree | None) -> bool:
    """Return whether parts of a world are too small beside the whole for float32."""
    if top is not None and float(top.instances["radius"].min()) < LEAST_SHARE:
        return True
    return any(shape.spans_scales for shape in shapes)


def make_exact_instances(arrays: SurfaceArrays, top: TopTree | None) -> NDArray[np.void]:
    """Return the (n,) `structs.EXACT_INSTANCE` of a world."""
    geometry = arrays.geometry_id
    records = np.zeros(len(geometry), EXACT_INSTANCE)
    origin, own_scale = arrays.origin[geometry], arrays.scale[geometry]
    records["origin"], records["scale"] = origin, own_scale
    records["to_world"] = records["to_object"] = np.eye(3)
    for name in ("first_vertex", "first_face", "first_solid"):
        records[name] = getattr(arrays, name)[geometry]
    if top is not None:
        shape = top.bvh.shape
        factor = shape.scale / own_scale[:, None, None]
        records["to_world"], records["to_object"] = arrays.linear * factor, arrays.inverse / factor
        place = np.einsum("nij,nj->ni", arrays.linear, origin) + arrays.offset
        records["centre"] = (place - shape.origin) * shape.scale
        condition = (np.abs(arrays.inverse) @ np.abs(arrays.linear)).sum(axis=2).max(axis=1)
        records["rounding"] = _MAP_ROUNDING * condition
        records["stretch"] = np.abs(records["to_object"]).sum(axis=2).max(axis=1)
    return records
