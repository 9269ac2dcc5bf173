"""The queries of a tracer in a scene whose trees are given, or left out."""

from clbvh import Tracer
from clbvh.device.open import open_device
from clbvh.trace.launch import Caster
from clbvh.trace.point_queries import PointQueries
from clbvh.trace.ray_queries import RayQueries
from clbvh.trace.world.trees import BRUTE
from clbvh.trace.world.world import open_world


class StateTracer(RayQueries, PointQueries):
    """In place of a `Tracer`; without `trees` the layout is ``"brute"``. Masks choose instances, names do not."""

    def __init__(self, state, device, trees=None):
        session = open_device(device)
        self._caster = Caster(session, open_world(session, state, trees))

    def close(self):
        self._caster.close()


def open_tracer(scene, device, layout):
    """A tracer of a random scene, in a layout, or in ``"brute"``."""
    return (
        StateTracer(scene.state, device) if layout == BRUTE else Tracer(scene.contents(), device=device, layout=layout)
    )
