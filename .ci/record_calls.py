"""Writes calls of the host's kernels to a file, with all memory before and after them, for .ci/replay.c.

A tree built by the device's builder, and pictures of triangles and of spheres; two calls of each kernel.
"""

from __future__ import annotations

import struct
import sys
from collections import Counter
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

import clbvh
from clbvh.device.host.library import HostBuffer, HostKernel
from clbvh.device.host.session import HostSession

_MOST_CALLS = 2
# The numbers of a launch before its slots, and a slot.
_SHAPE_BYTES, _SLOT_BYTES = 16, 8


def record(file: BinaryIO) -> None:
    """Record what `work` runs."""
    with_first, run, counts = HostKernel.with_first, HostSession.run, Counter[str]()

    def keep_first(kernel: Any, first: Any) -> Any:
        rest: Any = with_first(kernel, first)
        rest.whole, rest.first_arguments = kernel, dict(first)
        return rest

    def record_run(session: HostSession, kernel: Any, work_size: Any, work_group: Any, **arguments: Any) -> None:
        whole, given = getattr(kernel, "whole", kernel), getattr(kernel, "first_arguments", {}) | arguments
        name = kernel.entry.__name__.partition("_")[2]
        counts[name] += 1
        if counts[name] > _MOST_CALLS:
            run(session, kernel, work_size, work_group, **arguments)
            return
        groups = [-(-size // group) for size, group in zip(work_size, work_group, strict=True)]
        launch = whole.bind((*(*groups, 1)[:2], *(*work_group, 1)[:2]), given)
        buffers = {
            _SHAPE_BYTES + _SLOT_BYTES * slot: _bytes_of(given[argument])
            for slot, (argument, kind) in enumerate(zip(whole.argument_names, whole._kinds, strict=True))
            if kind is None and given[argument] is not None
        }
        before = [array.tobytes() for array in buffers.values()]
        run(session, kernel, work_size, work_group, **arguments)
        file.write(struct.pack("<q", len(name)) + name.encode())
        file.write(struct.pack("<qq", int(np.prod(groups)), len(launch)) + launch + struct.pack("<q", len(buffers)))
        for (offset, array), old in zip(buffers.items(), before, strict=True):
            file.write(struct.pack("<qq", offset, len(old)) + old + array.tobytes())

    HostKernel.with_first, HostSession.run = keep_first, record_run  # type: ignore[method-assign]
    try:
        work()
    finally:
        HostKernel.with_first, HostSession.run = with_first, run  # type: ignore[method-assign]


def work() -> None:
    """Build, and draw."""
    mesh = clbvh.make_shape("knot", triangles=2000)
    clbvh.build(mesh, quality="fast", device="host")
    size = {"width": 64, "height": 48}
    clbvh.render(mesh, shading="normal", **size)
    for shading in ("studio", "ao", "path"):
        clbvh.render(mesh, shading=shading, samples=2, **size)
    spheres = clbvh.Spheres(np.random.default_rng(1).normal(size=(500, 3)), 0.05)
    clbvh.render(spheres, shading="studio", samples=2, **size)


def _bytes_of(value: Any) -> Any:
    return value.array if isinstance(value, HostBuffer) else value.reshape(-1).view(np.uint8)


if __name__ == "__main__":
    with Path(sys.argv[1]).open("wb") as calls:
        record(calls)
