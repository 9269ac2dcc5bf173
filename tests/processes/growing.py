"""What tracers, builds, queries, pictures and pools leave behind: a script, run as ``... NAME WARM_UP COUNT``.

Prints one JSON object: the growth from after the warm-up to the end.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

import clbvh

_OWN = Path("/proc/self")
_PAGES_PER_MIB = 2**20 / os.sysconf("SC_PAGE_SIZE")


class Work:
    """Each piece of work that can be repeated."""

    def __init__(self):
        self.mesh = clbvh.make_shape("knot", triangles=1800)
        self.bvh = clbvh.build(self.mesh)
        self.rays = np.random.default_rng(0).normal(size=(2, 10, 3))
        self.scene = clbvh.make_shape("icosphere", triangles=80)
        self.objects = clbvh.Scene()
        self.object = self.objects.add(self.mesh)
        self.places = np.tile(np.eye(4), (100, 1, 1))
        self.places[:, 0, 3] = np.arange(100)
        self.objects.place_many(self.object, self.places)
        self.tracer = None
        self.moving = None
        self.renderer = None

    def tracers(self):
        """Open a tracer, ask it, and close it."""
        with clbvh.Tracer(self.bvh) as tracer:
            tracer.closest_hit(*self.rays)
            tracer.all_hits(*self.rays)

    def unclosed_tracers(self):
        """Open a tracer, ask it, and forget it."""
        clbvh.Tracer(self.bvh).closest_hit(*self.rays)

    def builds(self):
        """Build a tree in this process."""
        clbvh.build(self.mesh)

    def queries(self):
        """Ask one tracer."""
        self.tracer = self.tracer or clbvh.Tracer(self.bvh)
        self.tracer.closest_hit(*self.rays)

    def moves(self):
        """Move the instances of a scene, and ask its tracer."""
        self.moving = self.moving or clbvh.Tracer(self.objects)
        self.moving.set_transforms(self.objects.instances, self.places)
        self.moving.closest_hit(*self.rays)

    def deformations(self):
        """Move the vertices of a geometry of a scene, and ask its tracer."""
        self.moving = self.moving or clbvh.Tracer(self.objects)
        self.moving.set_vertices(self.object, self.mesh.vertices)
        self.moving.closest_hit(*self.rays)

    def pictures(self):
        """Render a picture."""
        clbvh.render(self.scene, width=32, height=32)

    def frames(self):
        """Render a picture with a renderer that stays."""
        self.renderer = self.renderer or clbvh.Renderer(self.scene, width=32, height=32)
        self.renderer.render(width=16)

    def renderers(self):
        """Open a renderer, render, and forget it."""
        clbvh.Renderer(self.scene, width=32, height=32).render()

    def pools(self):
        """Start workers, build, and stop them."""
        with clbvh.SubtreePool(2) as pool:
            clbvh.build(self.mesh, pool=pool, task_threshold=200)


def measure():
    """Return what this process holds, by name."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return {
        "MiB": int((_OWN / "statm").read_text().split()[1]) / _PAGES_PER_MIB,
        "handles": len(list((_OWN / "fd").iterdir())),
        "threads": len(list((_OWN / "task").iterdir())),
        "files": len(list(Path(tempfile.gettempdir()).iterdir())),
    }


def main(name, warm_up, count):
    """Repeat one piece of work."""
    work = getattr(Work(), name)
    for _ in range(warm_up):
        work()
    before = measure()
    for _ in range(count):
        work()
    after = measure()
    print(json.dumps({quantity: round(after[quantity] - before[quantity], 2) for quantity in after}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
