"""The options of the engine that is installed for all meshes, if one is, and those that hold for one mesh.

A module of its own, because the proximity functions read what `install.py` sets.
"""

from __future__ import annotations

from typing import Any, ClassVar

from .following_tracer import EngineOptions
from .ray import RayMeshIntersector


class Installed:
    """The engine that is installed in this process."""

    options: ClassVar[EngineOptions | None] = None


def options_for(mesh: Any) -> EngineOptions:
    """Return the options for proximity queries of a mesh: its ray engine's, the installed engine's, or the default."""
    ray = getattr(mesh, "__dict__", {}).get("ray")
    if isinstance(ray, RayMeshIntersector):
        return ray.options
    return Installed.options or EngineOptions()
