"""clbvh: a parallel BVH build on the host, exact ray casting with OpenCL on any device.

The names below are the public interface. They are imported when first used, so that `import clbvh` costs
nothing and a build needs no OpenCL driver.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .geometry import Mesh, load_mesh

_HOME_OF = {
    "Mesh": "geometry",
    "load_mesh": "geometry",
}

__all__ = ["Mesh", "load_mesh"]  # noqa: RUF022 - in the order of the pipeline


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'clbvh' has no attribute '{name}'")
    return getattr(import_module(f".{_HOME_OF[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
