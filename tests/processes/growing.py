"""What tracers, builds, queries, pictures and pools leave behind: a script, run as ``... NAME WARM_UP COUNT``.

Prints one JSON object: the growth from after the warm-up to the end.
"""

import ctypes
import gc
import json
import os
import sys
import tempfile
from functools import cached_property
from pathlib import Path

import numpy as np

import clbvh

_OWN = Path("/proc/self")
_PAGES_PER_MIB = 2**20 / os.sysconf("SC_PAGE_SIZE")
_SMALL = {"width": 32, "height": 32}


class Work:
    """Each piece of work that can be repeated."""

    def __init__(self):
        self.mesh = clbvh.make_shape("knot", triangles=1800)
        self.bvh = clbvh.build(self.mesh)
        self.rays = np.random.default_rng(0).normal(size=(2, 10, 3))
        self.ball = clbvh.make_shape("icosphere", triangles=80)
        self.objects = clbvh.Scene(self.mesh)
        self.places = np.tile(np.eye(4), (100, 1, 1))
        self.places[:, 0, 3] = np.arange(100)
        self.objects.place_many(self.objects.geometries[0], self.places[1:])

    @cached_property
    def tracer(self):
        return clbvh.Tracer(self.bvh)

    @cached_property
    def moving(self):
        return clbvh.Tracer(self.objects)

    @cached_property
    def renderer(self):
        return clbvh.Renderer(self.ball, **_SMALL)

    def tracers(self):
        with clbvh.Tracer(self.bvh) as tracer:
            tracer.closest_hit(*self.rays)
            tracer.all_hits(*self.rays)

    def unclosed_tracers(self):
        clbvh.Tracer(self.bvh).closest_hit(*self.rays)

    def builds(self):
        clbvh.build(self.mesh)

    def queries(self):
        self.tracer.closest_hit(*self.rays)

    def moves(self):
        self.moving.set_transforms(self.objects.instances, self.places)
        self.moving.closest_hit(*self.rays)

    def deformations(self):
        self.moving.set_vertices(self.objects.geometries[0], self.mesh.vertices)
        self.moving.closest_hit(*self.rays)

    def pictures(self):
        clbvh.render(self.ball, **_SMALL)

    def frames(self):
        self.renderer.render(width=16)

    def unclosed_renderers(self):
        clbvh.Renderer(self.ball, **_SMALL).render()

    def pools(self):
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
