"""The part of a tracer that its queries and moves share: the scene on the device, and who may change it."""

from __future__ import annotations

import threading

from ..errors import ConfigError
from ..support.context_manager import ContextManager
from .launch import Caster
from .scene.moving_scene import MovingScene
from .tree_copies import TreeCopies


class TracerBase(ContextManager):
    """A mesh or a scene on one device, as queries see it. `Tracer` opens and closes it."""

    # Each query reads it once, because a move replaces it.
    _caster: Caster
    # Of a tracer of a mesh: its trees on the device, the one in use and the one that a move writes.
    _copies: TreeCopies | None
    # Of a tracer of a scene.
    _scene: MovingScene | None
    # Held by a move, so that two of them do not write at the same time.
    _updating: threading.Lock

    def _known_scene(self) -> MovingScene:
        if self._scene is None:
            raise ConfigError("this tracer has no instances: open it with a clbvh.Scene, or call update(vertices)")
        return self._scene
