"""One build and its phases, as the report counts them."""

from __future__ import annotations

from typing import Any

from ..builders.build import build
from ..builders.processes.pool import SubtreePool
from ..bvh import Bvh
from ..geometry import Mesh

# Linked nodes become an array because a `Bvh` is one; the report's variants of these names did not need that.
NOT_COUNTED = "convert"

# Copies the mesh to the workers' memory; threads share it anyway, but processes cannot do without, so it counts.
PHASE = "phase."


def build_timed(mesh: Mesh, pool: SubtreePool | None, builder: str, **options: Any) -> tuple[Bvh, dict[str, float]]:
    """Build a tree.

    Returns
    -------
    bvh : Bvh
    values : dict of str to float
        ``build_ms``, wall time without the phase "convert", and each phase as ``phase.NAME_ms``.
    """
    bvh = build(mesh, pool=pool, builder=builder, **options)
    phases = {name: float(ms) for name, ms in bvh.timings_ms.items()}
    build_ms = sum(ms for name, ms in phases.items() if name != NOT_COUNTED)
    return bvh, {"build_ms": build_ms, **{f"{PHASE}{name}_ms": ms for name, ms in phases.items()}}
