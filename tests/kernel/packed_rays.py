"""Rays as the kernels take them."""

import numpy as np

from clbvh.structs import PACKED_RAY


def make_rays(origins, directions, t_min=0.0, t_max=np.inf):
    """An array of `structs.PACKED_RAY`; all rays may share an origin, a direction or limits."""
    origins, directions = np.broadcast_arrays(np.atleast_2d(origins), np.atleast_2d(directions))
    rays = np.empty(len(origins), PACKED_RAY)
    rays["origin"], rays["direction"] = origins, directions
    rays["t_min"], rays["t_max"] = t_min, t_max
    return rays
