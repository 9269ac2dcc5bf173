"""What the parts of a tracer share: queries and moves."""

from __future__ import annotations

from ..support.context_manager import ContextManager
from .launch import Caster
from .world.changes import Changes


class HasCaster(ContextManager):
    """A mesh or a scene on a device.

    Attributes
    ----------
    _caster : Caster
        Each query reads it once, because a move replaces it.
    _changes : Changes
        What handles of the scene name, and how its trees follow moves.
    """

    _caster: Caster
    _changes: Changes
