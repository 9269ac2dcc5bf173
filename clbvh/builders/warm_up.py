"""The smallest input that takes a builder through all its steps: it loads compiled code before a build is timed.

Workers load their code as well; this process waits for them, and counts the time as its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from ..structs import BOX_LANES
from ..support.code_times import LoadingCode, read_code_times
from .prim_refs import Bounds
from .sah.exhaustive_split import MAX_EXHAUSTIVE
from .workers.executor import Arrays, Executor, Step

# The fewest from which the default builder makes more than one range.
_TRIANGLES = MAX_EXHAUSTIVE + 1


def make_small_mesh() -> Mesh:
    """Return a mesh of a few triangles."""
    corners = np.arange(9 * _TRIANGLES).reshape(-1, 3)
    faces = np.arange(3 * _TRIANGLES, dtype=np.int32).reshape(-1, 3)
    return Mesh.from_arrays(corners, faces)


def make_small_bounds() -> Bounds:
    """Return the bounds of the primitives of `make_small_arrays`."""
    return np.zeros((2, BOX_LANES), np.float32)


def make_small_arrays() -> dict[str, NDArray[Any]]:
    """Return the arrays that the steps of `sah` and `hlbvh` share, for as many primitives, without extent."""
    return {
        "prim_refs": np.zeros((2, _TRIANGLES, BOX_LANES), np.float32),
        "prim_ids": np.zeros(_TRIANGLES, np.int32),
    }


def prepare_workers(executor: Executor, prepare: Step, *task: Any) -> None:
    """Let every worker run a step that compiles or loads what the others need."""
    with LoadingCode() as loading:
        loading.is_compiled = any(executor.run_on_each(_prepare, prepare, task))


def _prepare(arrays: Arrays, prepare: Step, task: tuple[Any, ...]) -> bool:
    """Run a step, and return whether something was compiled in it; a step."""
    before = read_code_times()
    prepare(arrays, *task)
    return read_code_times().since(before).compiled_count > 0
